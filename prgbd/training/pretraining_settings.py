"""``PretrainingSettings``: everything that can be chosen about self-supervised pre-training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Count, CountOrZero, NotNegative, Positive, Range, Seed
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

    epochs: Count = 20
    max_steps: Annotated[int, Range(-1, 10**9)] = -1
    batch_size: Count = 12
    learning_rate: Positive = 1e-4
    lr_step_epoch: Count = 15
    smoothness: NotNegative = 1e-3
    automask: bool = True
    augment: bool = True
    frame_gap: Count = 1
    min_motion: NotNegative = 1.0
    workers: CountOrZero = 0
    memory_mb: CountOrZero = 1024
    channels_last: bool = False
    compile: bool = False
    val_fraction: Annotated[float, Range(0, 0.5)] = 0.05
    checkpoint_minutes: NotNegative = 5.0
    seed: Seed = 0

    def __post_init__(self) -> None:
        check_types(self, "pretraining")
        if self.max_steps == 0:
            raise ConfigError(f"pretraining.max_steps is {self.max_steps}; it must be positive, or -1 for no limit.")
