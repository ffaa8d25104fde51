"""Checkpoints in the midst of a training, and what a training with several processes hands to the first one."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import Callback, Checkpoint

from prgbd.io.files import read_json, write_json

log = logging.getLogger(__name__)
FILE = "last.ckpt"


class StepCheckpoint(Checkpoint):
    """Saves the whole state of a training every few minutes, after a step of the optimiser.

    The file is replaced whole or not at all. With several processes all of them save after the same step.

    Args:
        folder: Of the file ``last.ckpt``.
        minutes: Time between two checkpoints; 0 saves after every step.
        epochs: Save after every epoch as well.
        key: What the training is about; a checkpoint with another key is not gone on from.
    """

    def __init__(self, folder: Path, minutes: float, *, epochs: bool = True, key: str = "") -> None:
        self.path = folder / FILE
        self._seconds, self._epochs, self._key = 60 * minutes, epochs, key
        self._saved = time.monotonic()

    def state_dict(self) -> dict[str, Any]:
        """Put the key into the checkpoint."""
        return {"key": self._key}

    def resumable(self) -> Path | None:
        """Return the checkpoint to go on from, or None where there is none that fits."""
        if not self.path.is_file():
            return None
        try:
            held = torch.load(self.path, map_location="cpu", weights_only=True, mmap=True)
            key = held["callbacks"][self.state_key]["key"]
        except Exception as error:  # a damaged file may raise anything, and costs no more than the work it held
            log.warning("%s cannot be read (%s); the training begins again.", self.path, type(error).__name__)
            return None
        return self.path if key == self._key else None

    def on_train_start(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Start the clock."""
        self._saved = time.monotonic()

    def on_train_batch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Save if it is time and the gradients are used up; the end of an epoch has a turn of its own."""
        stepped = (batch_idx + 1) % trainer.accumulate_grad_batches == 0
        if stepped and not trainer.is_last_batch and self._is_due(trainer):
            self._save(trainer)

    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Save after the held-out loss of the epoch was measured."""
        if self._epochs or self._is_due(trainer):
            self._save(trainer)

    def _is_due(self, trainer: lightning.Trainer) -> bool:
        due = time.monotonic() - self._saved >= self._seconds
        # The clocks of several processes differ, and all of them must come to save.
        return due if trainer.world_size == 1 else trainer.strategy.reduce_boolean_decision(due, all=False)

    def _save(self, trainer: lightning.Trainer) -> None:
        temporary = self.path.with_name(f".{FILE}.tmp")
        trainer.save_checkpoint(temporary)
        if trainer.is_global_zero:
            os.replace(temporary, self.path)
        self._saved = time.monotonic()


class Handover(Callback):
    """Brings plain figures of a training home from spawned processes, whose memory is lost with them.

    Args:
        folder: Where process 0 leaves them.
        *sources: Callbacks or modules whose ``handed_over()`` returns plain data, and whose ``take_over(data)`` takes
            it, in this order.
    """

    def __init__(self, folder: Path, *sources: Any) -> None:
        self._path, self._sources = folder / "handover.json", sources

    def on_fit_end(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Leave the figures, in the process of rank 0."""
        if trainer.strategy.launcher is not None and trainer.is_global_zero:
            write_json(self._path, [source.handed_over() for source in self._sources])

    def collect(self) -> None:
        """Take the figures over, in the process that spawned the others; nothing to do where it trained itself."""
        if not self._path.is_file():
            return
        for source, figures in zip(self._sources, read_json(self._path), strict=True):
            source.take_over(figures)
        self._path.unlink()


@contextmanager
def tensors_by_name() -> Iterator[None]:
    """Share tensors with spawned processes by files' names, not by open files.

    A process is spawned with at most some hundred open files, and every tensor of a network and of its images is one:
    "bad value(s) in fds_to_keep".
    """
    before = torch.multiprocessing.get_sharing_strategy()
    if "file_system" in torch.multiprocessing.get_all_sharing_strategies():
        torch.multiprocessing.set_sharing_strategy("file_system")
    try:
        yield
    finally:
        torch.multiprocessing.set_sharing_strategy(before)
