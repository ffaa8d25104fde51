"""``Lessons``: what each refinement of the loop learns from, and how, as the recipe chooses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from prgbd.core.criterion import Evidence
from prgbd.core.data import Sequence
from prgbd.core.types import SlamResult
from prgbd.loop.baselines import baseline_result, run_baseline
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.outcome import Failures
from prgbd.loop.recipe import frame_gaps, of_recordings, suspects, teacher
from prgbd.training.budget import read_budget
from prgbd.training.learning_plan import Choice, LearningPlan, learning_plan


@dataclass(frozen=True)
class Lesson:
    """One refinement before it begins.

    Attributes:
        supervised: Recordings and what SLAM made of them.
        plan: Options and budget.
        choices: What the options that said "auto" became, and why.
        baseline: The row of SLAM on the images alone, where it ran to be a teacher.
    """

    supervised: list[tuple[Sequence, SlamResult]]
    plan: LearningPlan
    choices: list[Choice]
    baseline: dict[str, Any] | None = None


def prepare(parts: LoopParts, loop: int, evidence: Mapping[str, Evidence]) -> Lesson:
    """Choose teacher, learning rate, batch and steps of a refinement; SLAM runs on the images alone if that may teach.

    Args:
        parts: What the loop works with.
        loop: Number of the loop.
        evidence: What SLAM on the network's depth left in it, by recording.
    """
    settings = parts.refinement
    assert settings is not None
    row = _mono(parts, loop, evidence)
    teachers = _teachers(parts, loop, evidence, row)
    supervised = [(s, _result(parts, loop, s, teachers[s.name].value)) for s in parts.sequences if s.name in teachers]
    choices = of_recordings(teachers) if loop == 0 and parts.settings.first_teacher == "auto" else []
    if not settings.frame_gap:
        choices.append(frame_gaps({sequence.name: result for sequence, result in supervised}))
    keyframes = sum(len(result.keyframes) for _, result in supervised)
    known = [e["disagreement"] for e in evidence.values() if e["disagreement"] is not None]
    mean = sum(known) / len(known) if known else None
    plan = learning_plan(settings, keyframes, read_budget(parts.settings.budget), mean)
    return Lesson(supervised, plan, [*choices, *plan.choices], row)


def _mono(parts: LoopParts, loop: int, evidence: Mapping[str, Evidence]) -> dict[str, Any] | None:
    """Run SLAM on the images alone where the first teacher asks for it; return its row, None where it does not."""
    first = parts.settings.first_teacher
    if loop > 0 or first == "pseudo_rgbd":
        return None
    wanted = [sequence for sequence in parts.sequences if first == "mono" or sequence.name in suspects(evidence)]
    if not wanted or not _knows_mono(parts):
        return None
    for name, why in suspects(evidence).items() if first == "auto" else ():
        parts.monitor.say(f"  {name}: {why}, so SLAM on the images alone is tried as its teacher")
    # Where it is only tried, an error of it ends nothing: SLAM on the network's depth can teach as well.
    failures = Failures(len(wanted) + (first == "auto"), parts.monitor)
    return run_baseline("mono", parts.make_slam, wanted, parts.settings, parts.store, parts.monitor, failures)


def _knows_mono(parts: LoopParts) -> bool:
    with parts.make_slam() as system:
        return parts.settings.first_teacher == "mono" or "mono" in system.modes


def _teachers(
    parts: LoopParts, loop: int, evidence: Mapping[str, Evidence], row: Mapping[str, Any] | None
) -> dict[str, Choice]:
    """Return the teacher of every recording."""
    first = "pseudo_rgbd" if loop > 0 else parts.settings.first_teacher
    pose = {} if row is None else row["pose"]
    if first != "auto":
        names = [sequence.name for sequence in parts.sequences]
        taught = [name for name in names if first != "mono" or name in pose]
        return {name: Choice("task.first_teacher", first, "it is given") for name in taught}
    tracked = {name: found["tracked_frames"] / max(found["frames"], 1) for name, found in pose.items()}
    return {name: teacher(found, tracked.get(name)) for name, found in evidence.items()}


def _result(parts: LoopParts, loop: int, sequence: Sequence, chosen: str) -> SlamResult:
    return baseline_result("mono", sequence, parts.store) if chosen == "mono" else parts.result(loop, sequence)
