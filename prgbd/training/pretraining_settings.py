"""``PretrainingSettings``: everything that can be chosen about self-supervised pre-training."""

from __future__ import annotations

from dataclasses import dataclass

from prgbd.core.errors import ConfigError
from prgbd.core.options import check_types


@dataclass(frozen=True)
class PretrainingSettings:
    """Options of pre-training; the defaults are Monodepth2's.

    Attributes:
        epochs: Passes over the training frames.
        max_steps: Optimiser steps at most; -1 for no limit.
        batch_size: Triplets per step.
        learning_rate: Of Adam, at the start.
        lr_step_epoch: The learning rate falls to a tenth after this many epochs.
        smoothness: Weight of the smoothness term.
        automask: Leave out what looks the same without motion.
        augment: Mirror half of the triplets and jitter the colours of half of them.
        frame_gap: How many frames away the two source frames are.
        min_motion: Frames whose image differs from a source frame by less than this mean absolute grey level (at a
            width of 64 pixels) do not train; the published data sets leave still frames out by hand-made lists.
        workers: Processes that load batches; images lie decoded in memory, so 0 is usually fastest.
        memory_mb: Decoded images beyond this lie in a file that goes at the end.
        channels_last: Memory layout that convolutions are faster in on most processors.
        compile: Compile the depth network with ``torch.compile``: about a minute once, then faster steps.
        val_fraction: Part of the triplets that is held out to watch the loss.
        checkpoint_minutes: A training that is stopped goes on from at most this many minutes before, or from the last
            end of an epoch; 0 saves its state after every step.
        seed: Of shuffling and augmentation.

    Raises:
        ConfigError: If a value cannot work.
    """

    epochs: int = 20
    max_steps: int = -1
    batch_size: int = 12
    learning_rate: float = 1e-4
    lr_step_epoch: int = 15
    smoothness: float = 1e-3
    automask: bool = True
    augment: bool = True
    frame_gap: int = 1
    min_motion: float = 1.0
    workers: int = 0
    memory_mb: int = 1024
    channels_last: bool = False
    compile: bool = False
    val_fraction: float = 0.05
    checkpoint_minutes: float = 5.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_types(self, "pretraining")
        for name in ("epochs", "batch_size", "learning_rate", "lr_step_epoch", "frame_gap"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ConfigError(f"pretraining.{name} is {getattr(self, name)}; it must be positive.")
        for name in ("smoothness", "min_motion", "workers", "memory_mb", "checkpoint_minutes"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ConfigError(f"pretraining.{name} is {getattr(self, name)}; it must be 0 or positive.")
        if self.max_steps < -1 or self.max_steps == 0:
            raise ConfigError(f"pretraining.max_steps is {self.max_steps}; it must be positive, or -1 for no limit.")
        if not 0 <= self.val_fraction <= 0.5:
            raise ConfigError(f"pretraining.val_fraction is {self.val_fraction}; it must lie between 0 and 0.5.")
