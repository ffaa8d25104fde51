"""Which samples a training step takes, decided by seed, epoch and process alone, so that a training can go on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import lightning
import numpy as np
import torch
from torch.utils.data import Sampler


def step_seed(seed: int, epoch: int, rank: int = 0, batch: int = 0) -> int:
    """Mix the seed of a run with epoch, process and batch, so that a step draws the same whatever came before it."""
    return int(np.random.SeedSequence([seed, epoch, rank, batch]).generate_state(1, np.uint64)[0])


class EpochSampler(Sampler[int]):
    """A shuffle that seed and epoch alone decide; each of several processes takes its share of the same shuffle.

    Shares are equally long: the first samples of the shuffle fill up the last ones.

    Args:
        count: Number of samples.
        seed: Of the run.
        rank: Of this process.
        world_size: Number of processes.
    """

    def __init__(self, count: int, seed: int, rank: int = 0, world_size: int = 1) -> None:
        self._count, self._seed, self._rank, self._world_size = count, seed, rank, world_size
        self._epoch = 0
        self._skipped = (-1, 0)

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch; Lightning calls it before every epoch."""
        self._epoch = epoch

    def skip(self, epoch: int, samples: int) -> None:
        """Leave out the first samples of an epoch, which were trained before the training was stopped."""
        self._skipped = (epoch, samples)

    def __len__(self) -> int:
        return -(-self._count // self._world_size)

    def __iter__(self) -> Iterator[int]:
        generator = torch.Generator().manual_seed(step_seed(self._seed, self._epoch))
        order = torch.randperm(self._count, generator=generator)
        share = order.repeat(1 + self._world_size)[: len(self) * self._world_size][self._rank :: self._world_size]
        epoch, samples = self._skipped
        yield from share[samples if epoch == self._epoch else 0 :].tolist()


class ResumableData(lightning.LightningDataModule):
    """Data whose position within an epoch is part of the checkpoint."""

    def __init__(self) -> None:
        super().__init__()
        self._position = {"epoch": -1, "batches": 0}

    def sampler(self, count: int, seed: int, batch_size: int) -> EpochSampler:
        """Make the shuffle of the training samples, at the position of the checkpoint if there was one."""
        trainer = self.trainer
        if trainer is None:
            return EpochSampler(count, seed)
        sampler = EpochSampler(count, seed, trainer.global_rank, trainer.world_size)
        # Processes that load batches begin before Lightning tells the epoch.
        sampler.set_epoch(trainer.fit_loop.epoch_progress.current.processed)  # type: ignore[attr-defined]
        sampler.skip(self._position["epoch"], self._position["batches"] * batch_size)
        return sampler

    def state_dict(self) -> dict[str, Any]:
        """Return the position: the epoch, and how many of its batches are done."""
        assert self.trainer is not None
        done = self.trainer.fit_loop.epoch_loop.batch_progress.current.processed  # type: ignore[attr-defined]
        return {"epoch": self.trainer.current_epoch, "batches": done}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over a position."""
        self._position = dict(state_dict)
