"""``TimedSteps``: a training that ends after a time, with a number of steps that is found once."""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

import lightning
from lightning.pytorch.callbacks import Callback

from prgbd.io.files import read_json, write_json

FILE = "steps.json"
WARM_UP = 2
"""Steps that are not timed: memory is allocated and kernels are chosen in them."""
TIMED = 5


class TimedSteps(Callback):
    """Turns a time into a number of steps by the median of the first ones, and ends the training after so many.

    The number is written once; a training that goes on after it was stopped ends after the same step.

    Args:
        seconds: The time.
        folder: Of the file ``steps.json``.
        key: What the training is about; the number of another one is not taken.
    """

    def __init__(self, seconds: float, folder: Path, key: str) -> None:
        self._seconds, self._path, self._key = seconds, folder / FILE, key
        self._took: list[float] = []
        self._began = 0.0

    def on_fit_start(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Take the number that was found before the training was stopped."""
        if self._path.is_file():
            found = read_json(self._path)
            if isinstance(found, dict) and found.get("key") == self._key:
                _end_after(trainer, int(found["steps"]))

    def on_train_batch_start(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        """Start the clock of a step."""
        self._began = time.perf_counter()

    def on_train_batch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Stop it, and find the number once enough steps were timed."""
        self._took.append(time.perf_counter() - self._began)
        if trainer.max_steps < 0 and len(self._took) == WARM_UP + TIMED:
            step = statistics.median(self._took[WARM_UP:]) * trainer.accumulate_grad_batches
            steps = trainer.strategy.broadcast(max(trainer.global_step, round(self._seconds / max(step, 1e-9))))
            if trainer.is_global_zero:
                write_json(self._path, {"key": self._key, "steps": steps, "seconds_per_step": step})
            _end_after(trainer, steps)


def _end_after(trainer: lightning.Trainer, steps: int) -> None:
    trainer.fit_loop.epoch_loop.max_steps = steps
