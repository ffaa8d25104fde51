"""The trajectories and maps of a recording in one frame: the truth's, or the first loop's where there is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.alignment import Alignment, fit_alignment
from prgbd.core.types import SlamResult, Trajectory
from prgbd.io.trajectory_files import match_times
from prgbd.report.drawing import BASELINE_COLOURS, loop_colours
from prgbd.report.figures import Path3D, horizontal_axes
from prgbd.report.interactive import Cloud
from prgbd.report.reading import Run
from prgbd.report.words import number

FEWEST_POSES = 3


@dataclass
class AlignedSequence:
    """What is drawn of one recording.

    Attributes:
        name: Of the recording.
        reference: What everything was aligned to.
        has_truth: Whether that is the truth.
        paths: The truth, if there is any, and the trajectories.
        clouds: The maps.
        errors: Per trajectory: label, colour, frame numbers and distances from the truth; empty without truth.
        left_out: Labels of trajectories with too few poses to be aligned.
    """

    name: str
    reference: Trajectory
    has_truth: bool
    paths: list[Path3D] = field(default_factory=list)
    clouds: list[Cloud] = field(default_factory=list)
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


def entry_colours(run: Run) -> dict[int, str]:
    """Return a colour for each entry of a run (baselines and loops) by its ``id()``."""
    baselines = run.entries[: len(run.entries) - len(run.loops)]
    found = dict(zip(map(id, baselines), BASELINE_COLOURS, strict=False))
    return found | dict(zip(map(id, run.loops), loop_colours(len(run.loops)), strict=True))


def aligned_sequence(run: Run, name: str, results: list[tuple[dict[str, Any], SlamResult]]) -> AlignedSequence:
    """Align results of a recording by Sim3.

    Args:
        run: The run.
        name: Of the recording.
        results: Entries of the run's summary with what they found, at least one.
    """
    colours = entry_colours(run)
    truth = run.truth(name)
    known = truth is not None and len(truth) >= FEWEST_POSES
    out = AlignedSequence(name, truth if truth is not None and known else results[0][1].trajectory, known)
    if truth is not None and len(truth):
        out.paths.append(Path3D("truth", np.arange(len(truth)), truth.positions))
    for loop, result in results:
        found = align(result.trajectory, out.reference)
        label, colour, frames = run.label(loop), colours[id(loop)], result.trajectory.frame_index
        if found is None:
            out.left_out.append(label)
            continue
        transform, rows, errors = found
        ate = ((loop.get("pose") or {}).get(name) or {}).get("ate_rmse")
        text = label + (f", {number(ate)} m" if ate is not None else "")
        out.paths.append(Path3D(text, frames, transform.points(result.trajectory.positions), colour))
        if len(result.points):
            out.clouds.append(Cloud(text, transform.points(result.points.xyz), result.points.rgb))
        if known:
            out.errors.append((label, colour, frames[rows], errors))
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
