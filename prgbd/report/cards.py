"""The cards at the top of a page: the few figures that sum up a run."""

from __future__ import annotations

from dataclasses import dataclass

from prgbd.report.reading import Run, sum_pose
from prgbd.report.words import Change, depth_change, held_out_change, number, pose_change


@dataclass(frozen=True)
class Card:
    """A figure with what it rests on.

    Attributes:
        name: What it is.
        value: Texts, each with whether it is set in small type.
        basis: What it rests on, or empty.
        change: How it changed over the loops, or None.
    """

    name: str
    value: list[tuple[str, bool]]
    basis: str = ""
    change: Change | None = None


def cards(run: Run) -> list[Card]:
    """Return the cards that a run has figures for."""
    summary, several = run.summary, len(run.kept_loops) > 1
    changes = {"Pose error": pose_change(summary), "Depth error": depth_change(summary)}
    if not any(changes.values()):
        changes = {"Held-out loss": held_out_change(summary)}
    found = [_change_card(name, change, several) for name, change in changes.items() if change]
    found += [_frames_card(run)] if run.loops and sum_pose(run.kept_loops[-1], "frames") else []
    if summary.get("seconds") is not None:
        passes = f"{len(run.loops)} SLAM passes" if len(run.loops) > 1 else ""
        found.append(Card("Time", _duration(float(summary["seconds"])), passes))
    return found


def _change_card(name: str, change: Change, several: bool) -> Card:
    value = [(f"{number(change.before)} →", True)] if several else []
    value.append((f"{number(change.after)}{change.unit}".replace(" ", "\N{NO-BREAK SPACE}"), False))
    return Card(name, value, change.basis, change if several else None)


def _frames_card(run: Run) -> Card:
    last = run.kept_loops[-1]
    value = [(f"{sum_pose(last, 'tracked_frames') or 0:,}", False), (f"of {sum_pose(last, 'frames'):,}", True)]
    counts = ((sum_pose(last, "keyframes"), "keyframes"), (sum_pose(last, "points"), "map points"))
    return Card("Frames with a pose", value, ", ".join(f"{count:,} {name}" for count, name in counts if count))


def _duration(seconds: float) -> list[tuple[str, bool]]:
    """Return the two largest units of a time, each number followed by its unit in small type."""
    if seconds < 60:
        return [(f"{seconds:.0f}", False), ("s", True)]
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    parts = [(hours, "h"), (minutes, "min")] if hours else [(minutes, "min"), (rest, "s")]
    return [text for count, unit in parts for text in ((str(count), False), (unit, True))]
