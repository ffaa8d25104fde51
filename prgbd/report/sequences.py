"""What the page shows of each sequence: trajectories over truth, errors over time, and tracking."""

from __future__ import annotations

from dataclasses import dataclass

from prgbd.report import figures
from prgbd.report.aligned import AlignedSequence, aligned_sequence, estimates
from prgbd.report.drawing import Drawing
from prgbd.report.figures import Estimate
from prgbd.report.interactive import View, view
from prgbd.report.reading import Run

MOST_SEQUENCES = 12
TIMELINE = (
    "State of every frame; white ticks are keyframes, ▲ loop closures, ● frames found again after tracking was lost. "
    "Below, the matches that agree with each frame's pose."
)
ERRORS = "Distance from the true position after Sim3 alignment, by frame; a gap is where there is no pose."


@dataclass(frozen=True)
class SequencePart:
    """One sequence on the page.

    Attributes:
        name: Of the sequence.
        view: Trajectories and map, None where no trajectory can be drawn.
        over_time: Tracking, and where there is truth the errors, by frame.
    """

    name: str
    view: View | None
    over_time: list[Drawing]


def sequence_parts(run: Run) -> list[SequencePart]:
    """Return the first ``MOST_SEQUENCES`` sequences, as far as SLAM has a result of them."""
    found = [(name, estimates(run, name, run.entries)) for name in run.sequences[:MOST_SEQUENCES]]
    return [_part(run, name, results) for name, results in found if results]


def _part(run: Run, name: str, found: list[Estimate]) -> SequencePart:
    drawn = aligned_sequence(name, found, run.truth(name))
    timelines = figures.timeline_figure(found)
    over_time = [Drawing(f"tracking of {name}", timelines, TIMELINE)]
    if drawn.errors:
        over_time.append(Drawing(f"position errors of {name}", figures.error_figure(drawn.errors), ERRORS))
    if not drawn.paths:
        return SequencePart(name, None, over_time)
    return SequencePart(name, trajectory_view(drawn, _caption(drawn), with_map=True), over_time)


def trajectory_view(drawn: AlignedSequence, caption: str, with_map: bool = False) -> View:
    """Return the trajectories of a sequence with the last maps, for the page.

    Args:
        drawn: The sequence.
        caption: Words below.
        with_map: Whether the drawing from above has the last map.
    """
    maps = [path.map.xyz for path in drawn.paths if path.map is not None]
    figure = figures.trajectory_figure(drawn.paths, drawn.axes, maps[-1] if maps and with_map else None, drawn.unit)
    drawing = Drawing(f"trajectories of {drawn.name} from above", figure, caption)
    return view(drawn.paths, drawn.axes, drawn.unit, drawing)


def _caption(drawn: AlignedSequence) -> str:
    if drawn.has_truth:
        text = "Seen from above, Sim3-aligned to the truth. The figure beside each name is its ATE RMSE."
    else:
        text = "Seen from above. There is no ground truth, so later loops are Sim3-aligned to the first."
    left_out = f" Too few poses to draw: {', '.join(drawn.left_out)}." if drawn.left_out else ""
    return f"{text} Dots: the last loop's map.{left_out}"
