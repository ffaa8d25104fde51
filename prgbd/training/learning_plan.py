"""What the options ``training.*`` and ``task.budget`` that say "auto" become for one refinement, and why."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from prgbd.training.budget import Budget
from prgbd.training.refinement_settings import AUTO, RefinementSettings

STRANGE = 0.3
"""Networks that know their scene err by 10 to 20 % against triangulated depth, those that do not by 40 to 50 %."""
KNOWN_RATE, STRANGE_RATE = 1e-4, 2e-4
"""Monodepth2's learning rate goes on where pre-training ended; what has nothing to lose may learn faster."""
SMALL_BATCH, LARGE_BATCH = 4, 12
"""Many noisy steps from few keyframes, or pre-training's batches where these alone fill the budget."""
PASSES = 10
MOST_STEPS = 300
"""Ten passes over RedKitchen's hundred keyframes: minutes on a laptop, whatever the recording's length."""
FEWEST_STEPS = 30


@dataclass(frozen=True)
class Choice:
    """What became of an option that was left to the recording, for ``summary.json`` and the report.

    Attributes:
        option: Its dotted name.
        value: What it became.
        why: A clause.
    """

    option: str
    value: Any
    why: str


@dataclass(frozen=True)
class LearningPlan:
    """A refinement whose numbers are all known.

    Attributes:
        settings: The options, ``learning_rate`` and ``batch_size`` being numbers.
        budget: When it ends; None where ``settings.epochs`` says so.
        choices: What "auto" became.
    """

    settings: RefinementSettings
    budget: Budget | None
    choices: tuple[Choice, ...] = ()


def learning_plan(
    settings: RefinementSettings, keyframes: int, budget: Budget | None = None, disagreement: float | None = None
) -> LearningPlan:
    """Choose learning rate, batch and steps by the number of keyframes and by how well the network knows the scene.

    Args:
        settings: The options, as given.
        keyframes: How many there are to learn from.
        budget: The user's; None leaves it to the number of keyframes.
        disagreement: Mean absolute log ratio of the network's depth to triangulated depth, less each keyframe's own
            scale (``Evidence``); None where it is not known, which counts as a network that knows the scene.
    """
    choices = []
    rate = settings.learning_rate
    if rate == AUTO:
        strange = is_strange(disagreement)
        rate = STRANGE_RATE if strange else KNOWN_RATE
        who = "does not know the scene" if strange else "knows the scene"
        err = "" if disagreement is None else f": {disagreement:.0%} off triangulated depth"
        choices.append(Choice("training.learning_rate", rate, f"the network {who}{err}"))
    if settings.batch_size == AUTO:
        many = keyframes >= LARGE_BATCH * MOST_STEPS
        batch = LARGE_BATCH if many else min(SMALL_BATCH, max(keyframes, 1))
        why = "one pass fills the steps" if many else "small batches make more steps"
        choices.append(Choice("training.batch_size", batch, f"{keyframes} keyframes: {why}"))
    else:
        batch = settings.batch_size
    if settings.epochs != AUTO:
        budget = None
    elif budget is None:
        steps = min(max(math.ceil(PASSES * keyframes / batch), FEWEST_STEPS), MOST_STEPS)
        budget = Budget(steps=steps)
        choices.append(Choice("task.budget", steps, f"{PASSES} passes over {keyframes} keyframes{_bound(steps)}"))
    return LearningPlan(replace(settings, learning_rate=rate, batch_size=batch), budget, tuple(choices))


def is_strange(disagreement: float | None) -> bool:
    """Say whether triangulation refutes the network's depth."""
    return disagreement is not None and disagreement > STRANGE


def _bound(steps: int) -> str:
    """Say which bound cut the number of steps, "" for none."""
    bounds = {MOST_STEPS: "at most", FEWEST_STEPS: "at least"}
    return f", {bounds[steps]} {steps} steps" if steps in bounds else ""
