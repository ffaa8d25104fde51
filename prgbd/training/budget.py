"""How long a refinement may learn: a number of steps, or a time that its first steps turn into one."""

from __future__ import annotations

import re
from dataclasses import dataclass

from prgbd.core.errors import ConfigError
from prgbd.core.option_errors import shown

SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}
MOST_STEPS = 10**9
_FORM = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|)")


@dataclass(frozen=True)
class Budget:
    """How long one refinement may learn.

    Attributes:
        steps: Steps of the optimiser; None where a time decides.
        seconds: Time of the steps, without the measurements before and after them; None where a number decides.
    """

    steps: int | None = None
    seconds: float | None = None

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.steps} steps" if self.seconds is None else f"{self.seconds:g} s of steps"


def read_budget(given: str | int) -> Budget | None:
    """Return the budget that ``task.budget`` names: ``500`` steps, ``90s``, ``10min`` or ``1h``; None for ``auto``.

    Raises:
        ConfigError: If it is none of them, or nothing at all.
    """
    if given == "auto":
        return None
    match = _FORM.fullmatch(str(given).strip())
    amount = float(match[1]) if match else 0.0
    if match is None or not 0 < amount <= MOST_STEPS or (not match[2] and not amount.is_integer()):
        raise ConfigError(
            f"task.budget is {shown(given)}; give a number of steps (500), a time (90s, 10min, 1h), or auto."
        )
    return Budget(seconds=amount * SECONDS[match[2]]) if match[2] else Budget(steps=int(amount))


def check_ends(budget: str | int, epochs: str | int) -> None:
    """Refuse ``task.budget`` beside ``training.epochs``, which both say when a refinement ends.

    Raises:
        ConfigError: If neither is "auto".
    """
    if "auto" not in (budget, epochs):
        raise ConfigError(
            f"task.budget={budget} and training.epochs={epochs} both say when a refinement ends; set "
            "training.epochs=auto, or leave task.budget out."
        )
