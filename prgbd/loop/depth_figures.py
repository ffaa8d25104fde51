"""How good the network's depth is, and pictures of it, from what the sensors have predicted already."""

from __future__ import annotations

from collections.abc import Sequence as Seq
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.depth_kind import DepthKind
from prgbd.evaluation.depth import DEFAULT_CAP, DepthEvaluation
from prgbd.evaluation.settings import EvaluationSettings
from prgbd.io.files import atomic_path
from prgbd.loop.sensing import DepthSensor

SAMPLES = 6
NEAREST = DEFAULT_CAP[0]


def evenly(count: int, wanted: int | None) -> NDArray[np.int64]:
    """Return at most ``wanted`` evenly spaced numbers below ``count``; all for None."""
    if wanted is None or wanted >= count:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, max(wanted, 1)).round().astype(np.int64))


def depth_figures(sensors: Seq[DepthSensor], settings: EvaluationSettings | None = None) -> dict[str, Any] | None:
    """Evaluate the predicted depth of sequences against their truth.

    Args:
        sensors: The network on each sequence.
        settings: Images, cap, crop, scaling, further caps and bins; the defaults for None.

    Returns:
        The metrics and their protocol, or None without any truth.
    """
    chosen = settings or EvaluationSettings()
    evaluation = DepthEvaluation(
        (NEAREST, chosen.depth_cap),
        chosen.depth_crop,
        chosen.median_scaling,
        chosen.chosen_caps,
        chosen.chosen_bins,
        any(sensor.estimator.depth_kind == DepthKind.AFFINE_DISPARITY for sensor in sensors),
    )
    truth_seen = False
    for sensor in sensors:
        for index in evenly(len(sensor), chosen.depth_images):
            truth = sensor.sequence.depth(int(index))
            if truth is None:
                evaluation.skip()
                continue
            truth_seen = True
            evaluation.add(truth, sensor.depth(int(index)))
    return evaluation.result() if truth_seen else None


def write_samples(sensors: Seq[DepthSensor], path: Path, count: int = SAMPLES) -> None:
    """Write a few frames with their predicted and true depth, the same frames in every loop.

    The file holds ``images`` (n, H, W, 3) uint8, ``depth`` (n, H, W) float32 in the network's unit, ``truth``
    (n, H, W) float32 metres with 0 where unknown (absent without any), ``sigma`` (n, H, W) float16, the predicted
    standard deviation of log depth (absent where not all frames have it), ``frame_index`` (n,) and ``sequence`` (n,).
    Sequences of another size than the first are resized to it.

    Args:
        sensors: The network on each sequence.
        path: The ``.npz`` file.
        count: How many frames in all, at least one for each of the first ``count`` sequences.
    """
    chosen = sensors[:count]
    share = max(1, count // max(len(chosen), 1))
    camera = chosen[0].sequence.camera
    size = (camera.width, camera.height)
    columns: dict[str, list[Any]] = {
        name: [] for name in ("images", "depth", "truth", "sigma", "frame_index", "sequence")
    }
    for sensor in chosen:
        for index in evenly(len(sensor), share + 2)[1:-1] if len(sensor) > share + 2 else evenly(len(sensor), share):
            frame = sensor.frame(int(index))
            assert frame.depth is not None
            columns["images"].append(cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA))
            columns["depth"].append(cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST))
            columns["truth"].append(_truth(sensor.sequence, int(index), size))
            if frame.depth_sigma is not None:
                sigma = cv2.resize(frame.depth_sigma, size, interpolation=cv2.INTER_NEAREST)
                columns["sigma"].append(sigma.astype(np.float16))
            columns["frame_index"].append(int(index))
            columns["sequence"].append(sensor.sequence.name)
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    if not arrays["truth"].any():
        del arrays["truth"]
    if len(columns["sigma"]) < len(columns["depth"]):
        del arrays["sigma"]
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)  # type: ignore[arg-type]


def _truth(sequence: Sequence, index: int, size: tuple[int, int]) -> NDArray[np.float32]:
    truth = sequence.depth(index)
    if truth is None:
        return np.zeros(size[::-1], np.float32)
    return np.asarray(cv2.resize(truth, size, interpolation=cv2.INTER_NEAREST), np.float32)
