"""Small plug-ins, good and bad, for the tests of the registry and of the checks."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from prgbd import DepthEstimator, DepthPrediction, Frame, PinholeCamera, Sequence


class Constant(DepthEstimator):
    """Predicts one learnable depth everywhere."""

    input_size = (32, 64)
    depth_range = (0.1, 100.0)

    def __init__(self, weights: str | None = None, value: float = 2.0) -> None:
        super().__init__()
        self.value = value
        self.log_depth = nn.Parameter(torch.tensor(float(np.log(value))))

    def forward(self, images: torch.Tensor) -> DepthPrediction:
        return DepthPrediction((self.log_depth.exp().expand(len(images), 1, *images.shape[2:]),))


class NotANumber(Constant):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth * torch.nan,))


class Zero(Constant):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth * 0,))


class WrongShape(Constant):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth[:, 0],))


class NotAPrediction(Constant):
    def forward(self, images):
        return super().forward(images).depth


class Raises(Constant):
    def forward(self, images):
        return 1 / 0


class FailsToStart(Constant):
    def __init__(self) -> None:
        raise RuntimeError("no licence")


class Ramp(Sequence):
    """A few frames of a gradient."""

    def __init__(self, sequence: str | None = None, frames: int = 4) -> None:
        self.name = "ramp"
        self.camera = PinholeCamera(16, 8, 20.0, 20.0, 7.5, 3.5)
        self.timestamps = np.arange(frames) * 0.1

    def frame(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise IndexError(index)
        image = np.tile(np.arange(16, dtype=np.uint8)[None, :, None] * 10 + index, (8, 1, 3))
        return Frame(index, float(self.timestamps[index]), image)


class Clips(Ramp):
    """A data set of two recordings."""

    def __init__(self, sequence: str | None = None, frames: int = 4) -> None:
        super().__init__(sequence, frames)
        self.name = sequence or "a"

    @classmethod
    def available(cls, frames: int = 4) -> list[str]:
        return ["a", "b"]


class Alone(Ramp):
    """A recording whose constructor knows no names."""

    def __init__(self) -> None:
        super().__init__()
