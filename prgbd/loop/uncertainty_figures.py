"""Whether the deviations that sensors predict are true: against true depth, and against SLAM's triangulated points."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as Many
from typing import Any

import numpy as np

from prgbd.core.multiview import rows_by_group
from prgbd.core.types import SlamResult
from prgbd.core.undistortion import Undistorter
from prgbd.evaluation.settings import EvaluationSettings
from prgbd.evaluation.triangulated_depth import triangulated_observations
from prgbd.evaluation.uncertainty import UncertaintyEvaluation
from prgbd.loop.depth_figures import NEAREST, evenly
from prgbd.loop.sensing import DepthSensor
from prgbd.training.supervision import clean_observations

_KEYFRAMES = 64  # of a recording, evenly spaced
_FEWEST_POINTS = 20


def uncertainty_figures(
    sensors: Many[DepthSensor],
    settings: EvaluationSettings | None = None,
    results: Iterable[tuple[DepthSensor, SlamResult]] = (),
) -> dict[str, Any] | None:
    """Compare what sensors say of their error with what it is.

    Args:
        sensors: The network on the recordings whose depth is evaluated.
        settings: Images, cap and crop.
        results: The network on recordings, and what SLAM made of them.

    Returns:
        Figures of ``UncertaintyEvaluation`` by what depth was compared with, ``truth`` and ``points``, as far as there
        are any; None for networks that predict no deviation.
    """
    found = {"truth": _against_truth(sensors, settings or EvaluationSettings()), "points": _against_points(results)}
    known = {name: figures for name, figures in found.items() if figures is not None}
    return known or None


def _against_truth(sensors: Many[DepthSensor], settings: EvaluationSettings) -> dict[str, Any] | None:
    evaluation = UncertaintyEvaluation()
    for sensor in sensors:
        if sensor.prepare().sigma is None:
            continue
        for index in evenly(len(sensor), settings.depth_images).tolist():
            truth, sigma = sensor.sequence.depth(index), sensor.sigma(index)
            if truth is not None and sigma is not None:
                cap = (NEAREST, settings.depth_cap)
                evaluation.add_image(truth, sensor.depth(index), sigma, cap, settings.depth_crop)
    return evaluation.result()


def _against_points(results: Iterable[tuple[DepthSensor, SlamResult]]) -> dict[str, Any] | None:
    evaluation = UncertaintyEvaluation()
    for sensor, result in results:
        if sensor.prepare().sigma is None:
            continue
        seen = clean_observations(result)
        rows, depth = triangulated_observations(result, seen)
        groups = rows_by_group(seen.keyframe[rows], _FEWEST_POINTS)
        lens = Undistorter(result.camera)
        for group in (groups[i] for i in evenly(len(groups), _KEYFRAMES)):
            frame = int(result.keyframes.frame_index[seen.keyframe[rows[group[0]]]])
            sigma = sensor.sigma(frame)
            assert sigma is not None
            last = np.array([result.camera.width, result.camera.height]) - 1
            column, row = np.clip(np.rint(seen.uv[rows[group]]), 0, last).astype(int).T
            predicted, deviation = (lens.depth(values)[row, column] for values in (sensor.depth(frame), sigma))
            known = (predicted > 0) & (deviation > 0)  # what undistortion brought in from outside is 0
            evaluation.add(np.log(predicted[known].astype(np.float64) / depth[group][known]), deviation[known])
    return evaluation.result()


def describe_uncertainty(figures: dict[str, Any]) -> str:
    """Return one line about ``uncertainty_figures``."""
    against, name = ("truth", "true depth") if "truth" in figures else ("points", "triangulated points")
    found = figures[against]
    order = "" if found["ause"] is None else f", area under the sparsification error {found['ause']:.2f} of chance"
    return (
        f"  uncertainty, against {name}: {found['within_one']:.0%} of the errors within one deviation, "
        f"{found['within_two']:.0%} within two{order}"
    )
