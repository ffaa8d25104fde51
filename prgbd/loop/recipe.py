"""The recipe of a run: what the options that say "auto" become by what SLAM found, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from prgbd.core.criterion import Evidence
from prgbd.core.types import SlamResult
from prgbd.loop.loop_settings import SelfImprovement
from prgbd.training.learning_plan import STRANGE, Choice, is_strange
from prgbd.training.refinement_settings import AUTO, RefinementSettings
from prgbd.training.supervision import measured_gap

WORSE = 0.05
"""A trajectory with fewer poses by this share of the frames is clearly worse."""
TEACHERS = {"mono": "SLAM on the images alone", "pseudo_rgbd": "SLAM on the network's depth"}


def suspects(evidence: Mapping[str, Evidence]) -> dict[str, str]:
    """Return the recordings that SLAM on the images alone should be tried on as a teacher, each with the reason.

    Args:
        evidence: What SLAM on the network's depth left, by recording.
    """
    found = {}
    for name, seen in evidence.items():
        if is_strange(seen["disagreement"]):
            found[name] = f"its depth differs from triangulated depth by {seen['disagreement']:.0%}"
        elif seen["tracked"] < 1 - WORSE:
            found[name] = f"SLAM on its depth has a pose for {seen['tracked']:.0%} of the frames"
    return found


def teacher(evidence: Evidence, mono_tracked: float | None) -> Choice:
    """Choose what the first refinement learns from on one recording.

    Args:
        evidence: What SLAM on the network's depth left.
        mono_tracked: Share of the frames that SLAM on the images alone has a pose for; None if it was not tried.
    """
    tracked, disagreement = evidence["tracked"], evidence["disagreement"]
    chosen, why = "pseudo_rgbd", "triangulation does not refute the network's depth"
    if disagreement is not None:
        limit = "above" if is_strange(disagreement) else "below"
        why = f"the network's depth differs from triangulated depth by {disagreement:.0%}, {limit} {STRANGE:.0%}"
    if mono_tracked is not None and mono_tracked < tracked - WORSE:
        why += f", but without depth {mono_tracked:.0%} of the frames have a pose in place of {tracked:.0%}"
    elif mono_tracked is not None and is_strange(disagreement):
        chosen = "mono"
    elif mono_tracked is not None and mono_tracked > tracked + WORSE:
        chosen, why = "mono", f"with depth {tracked:.0%} of the frames have a pose, without it {mono_tracked:.0%}"
    return Choice("task.first_teacher", chosen, why)


def frame_gaps(results: Mapping[str, SlamResult]) -> Choice:
    """Say how far apart the adjacent frames of recordings are, see ``supervision.measured_gap``."""
    gaps = {name: measured_gap(result) for name, result in results.items()}
    same = len(set(gaps.values())) == 1
    value = next(iter(gaps.values())) if same else ", ".join(f"{gap} on {name}" for name, gap in gaps.items())
    return Choice("training.frame_gap", value, "so many frames it takes to see the scene from another place")


def of_recordings(choices: Mapping[str, Choice]) -> list[Choice]:
    """Join the choices of several recordings that agree: one for each value, with the reason of the first."""
    groups: dict[Any, list[str]] = {}
    for name, choice in choices.items():
        groups.setdefault(choice.value, []).append(name)
    joined = []
    for value, names in groups.items():
        first = choices[names[0]]
        where = "" if len(groups) == 1 else f"{', '.join(names)}: "
        joined.append(Choice(first.option, value, where + first.why))
    return joined


def announcement(settings: SelfImprovement, refinement: RefinementSettings | None) -> str:
    """Say at the start of a run what is going to be chosen, and by what."""
    given: dict[str, Any] = {"teacher": settings.first_teacher, "steps": settings.budget}
    if refinement is not None:
        given |= {"learning rate": refinement.learning_rate, "batch": refinement.batch_size}
        if refinement.epochs != AUTO:
            given["steps"] = f"those of {refinement.epochs} epochs"
    open_ = [name for name, value in given.items() if value == AUTO]
    fixed = [f"{name} {value}" for name, value in given.items() if value != AUTO]
    told = f"what SLAM finds decides about {', '.join(open_)}" if open_ else "nothing is left to what SLAM finds"
    more = f"; given: {', '.join(fixed)}" if fixed else ""
    return f"Recipe: {told}{more}; task.criterion={settings.criterion} decides what is kept."


def sentences(choices: list[Choice]) -> list[str]:
    """Say in two sentences who teaches and how long the network learns; fewer where less was left open."""
    teachers = [c for c in choices if c.option == "task.first_teacher"]
    told = []
    if teachers:
        told.append("Teacher: " + "; ".join(f"{TEACHERS[c.value]}, for {c.why}" for c in teachers) + ".")
    rest = [c for c in choices if c.option != "task.first_teacher"]
    if rest:
        told.append("Learning: " + "; ".join(f"{c.option}={c.value} ({c.why})" for c in rest) + ".")
    return told


def plain(loop: int, choices: list[Choice]) -> dict[str, Any]:
    """Return the choices of a loop as an entry of ``recipe`` in ``summary.json``."""
    return {"loop": loop, "choices": [asdict(choice) for choice in choices], "sentences": sentences(choices)}
