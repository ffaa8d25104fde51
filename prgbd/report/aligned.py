"""The trajectories and maps of a recording in one frame: the truth's, or the first trajectory's where there is none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.alignment import Alignment, fit_alignment
from prgbd.core.types import Trajectory
from prgbd.io.trajectory_files import match_times
from prgbd.report.drawing import BASELINE_COLOURS, loop_colours
from prgbd.report.figures import Estimate, Path3D, horizontal_axes
from prgbd.report.reading import Run

FEWEST_POSES = 3


def ate_of(entry: dict[str, Any], name: str) -> float | None:
    """Return the ATE RMSE of a recording in an entry of the summary."""
    return ((entry.get("pose") or {}).get(name) or {}).get("ate_rmse")


def estimates(run: Run, name: str, chosen: Iterable[dict[str, Any]]) -> list[Estimate]:
    """Return what those of the chosen entries (baselines and loops) found of a recording that have a result."""
    baselines = run.entries[: len(run.entries) - len(run.loops)]
    colours = dict(zip(map(id, baselines), BASELINE_COLOURS, strict=False))
    colours |= dict(zip(map(id, run.loops), loop_colours(len(run.loops)), strict=True))
    found = [(entry, run.result(entry, name)) for entry in chosen]
    return [
        Estimate(run.label(entry), colours[id(entry)], result, ate_of(entry, name))
        for entry, result in found
        if result is not None
    ]


@dataclass
class AlignedSequence:
    """What is drawn of one recording.

    Attributes:
        name: Of the recording.
        reference: What everything was aligned to.
        has_truth: Whether that is the truth.
        paths: The truth, if there is any, and the trajectories with their maps.
        errors: Per trajectory: label, colour, frame numbers and distances from the truth; empty without truth.
        left_out: Labels of trajectories with too few poses to be aligned.
    """

    name: str
    reference: Trajectory
    has_truth: bool
    paths: list[Path3D] = field(default_factory=list)
    errors: list[tuple[str, str, NDArray[np.int64], NDArray[np.float64]]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    @property
    def axes(self) -> tuple[int, int]:
        """World axes to the right and up of a view from above."""
        return horizontal_axes(self.reference.wTc)

    @property
    def unit(self) -> str:
        """Unit of lengths."""
        return "m" if self.has_truth else "map units"


def aligned_sequence(name: str, found: Sequence[Estimate], truth: Trajectory | None) -> AlignedSequence:
    """Align what was found of a recording by Sim3.

    Args:
        name: Of the recording.
        found: What is drawn, at least one.
        truth: The true poses, if they are known.
    """
    known = truth is not None and len(truth) >= FEWEST_POSES
    out = AlignedSequence(name, truth if truth is not None and known else found[0].result.trajectory, known)
    if truth is not None and len(truth):
        out.paths.append(Path3D("truth", np.arange(len(truth)), truth.positions))
    for estimate in found:
        trajectory, points = estimate.result.trajectory, estimate.result.points
        aligned = align(trajectory, out.reference)
        if aligned is None:
            out.left_out.append(estimate.label)
            continue
        transform, rows, errors = aligned
        mapped = replace(points, xyz=transform.points(points.xyz)) if len(points) else None
        xyz = transform.points(trajectory.positions)
        out.paths.append(Path3D(estimate.title, trajectory.frame_index, xyz, estimate.colour, mapped))
        if known:
            out.errors.append((estimate.label, estimate.colour, trajectory.frame_index[rows], errors))
    return out


def align(
    estimate: Trajectory, reference: Trajectory
) -> tuple[Alignment, NDArray[np.int64], NDArray[np.float64]] | None:
    """Return the Sim3 alignment to the reference, the rows it rests on and their distances; None if too few."""
    rows, others = match_times(estimate.timestamp, reference.timestamp, 0.02)
    if len(rows) < FEWEST_POSES:
        return None
    x, y = estimate.positions[rows], reference.positions[others]
    transform = fit_alignment(x, y, "sim3")
    return transform, rows, np.linalg.norm(transform.points(x) - y, axis=1)
