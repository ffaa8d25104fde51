"""Callbacks, loggers and an accelerator that note what Lightning does with them."""

from __future__ import annotations

import torch
from lightning.pytorch.accelerators import CUDAAccelerator
from lightning.pytorch.callbacks import Callback


class Counting(Callback):
    """Counts the trainings that it sees; all of its kind count together."""

    trainings = 0

    def __init__(self, step: int = 1) -> None:
        self.step = step

    def on_fit_start(self, trainer, pl_module) -> None:
        Counting.trainings += self.step


class FakeGpu(CUDAAccelerator):
    """A GPU where there is none: it can be chosen by its number, but nothing can be moved to it."""

    @staticmethod
    def is_available() -> bool:
        return True

    @staticmethod
    def parse_devices(devices):
        return [0] if isinstance(devices, int | str) else list(devices)

    @staticmethod
    def get_parallel_devices(devices):
        return [torch.device("cuda", number) for number in devices]


class FakeGpuOnCpu(FakeGpu):
    """One that computes on the CPU in truth, and notes whether the network was moved to it."""

    in_use = False

    @staticmethod
    def get_parallel_devices(devices):
        return [torch.device("cpu")]

    def setup_device(self, device) -> None:
        self.in_use = True

    def teardown(self) -> None:
        """Leave the real one alone."""
