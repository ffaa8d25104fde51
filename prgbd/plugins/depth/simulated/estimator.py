"""``SimulatedDepth``: true depth with known errors in the place of a network's."""

from __future__ import annotations

import zlib
from statistics import NormalDist
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import ContractError, DataError
from prgbd.core.options import from_mapping
from prgbd.core.types import DepthPrediction, Frame
from prgbd.plugins.depth.simulated.noise import stationary, video_noise
from prgbd.plugins.depth.simulated.options import NEAREST, SensorErrors

# Numbers of the independent draws.
_SCALE, _SHIFT, _OWN, _OUTLIERS = range(4)


class SimulatedDepth(DepthEstimator):
    """The true depth of a recording, corrupted by errors of known size and correlation.

    It stands where a network does, but there is nothing to learn, and it looks at frames of recordings with true
    depth, not at images. Where the truth is unknown (the sky, holes of a sensor) it is the farthest of the frame. Every
    frame's errors follow from the seed, the recording's name and the frame's number, in whatever order they are read.

    Args:
        **options: Those of ``SensorErrors``.

    Raises:
        ConfigError: If an option is unknown or cannot work.
    """

    input_size = (256, 384)  # any serves: what it looks at has the size of the recording's images
    depth_kind = DepthKind.METRIC

    def __init__(self, **options: Any) -> None:
        super().__init__()
        self.errors = from_mapping(SensorErrors, options, "depth")
        self.depth_range = (NEAREST, self.errors.farthest)

    def extra_repr(self) -> str:
        """What sets its depth apart from another one's."""
        return repr(self.errors)

    def observe(self, sequence: Sequence, frame: Frame) -> Tensor:
        """Return the depth of a frame, (1, H, W) float32: ``forward`` has nothing to add."""
        return torch.from_numpy(self.depth(sequence, frame.index))[None]

    def forward(self, images: Tensor) -> DepthPrediction:
        """Return what was observed.

        Args:
            images: (B, 1, H, W) of ``observe``.

        Raises:
            ContractError: If they are pictures.
        """
        if images.shape[1] != 1:
            raise _blind()
        return DepthPrediction((images.float(),))

    def preprocess(self, image: NDArray[np.uint8]) -> Tensor:
        """Refuse an image, for it does not tell which frame of which recording it is.

        Raises:
            ContractError: Always.
        """
        raise _blind()

    def depth(self, sequence: Sequence, index: int) -> NDArray[np.float32]:
        """Return the simulated depth of a frame, (H, W) float32 metres, positive everywhere.

        Args:
            sequence: A recording with true depth.
            index: Number of the frame.

        Raises:
            DataError: If the frame has no true depth.
        """
        truth = sequence.depth(index)
        if truth is None or not truth.any():
            raise DataError(
                f"Frame {index} of '{sequence.name}' has no true depth, which depth=simulated makes its depth of; "
                "choose data that has it, such as data=synthetic."
            )
        errors, seed = self.errors, [self.errors.seed, zlib.crc32(sequence.name.encode())]
        depth = self._shifted(np.where(truth > 0, truth, truth.max()).astype(np.float64), seed, index)
        depth *= np.exp(errors.bias + errors.scale_sigma * _at(index, [*seed, _SCALE], errors.scale_length))
        if errors.own_sigma:
            drawn = video_noise([*seed, _OWN], index, truth.shape, errors.own_length, errors.own_frames)
            depth *= np.exp(errors.own_sigma * drawn)
        if errors.outliers:
            depth[self._in_blob(seed, index, truth.shape)] *= errors.outlier_factor
        return np.clip(depth, *self.depth_range).astype(np.float32)

    def _shifted(self, depth: NDArray[np.float64], seed: list[int], index: int) -> NDArray[np.float64]:
        """Blur and shift the inverse of depth (H, W), as far as asked for; what would lie behind the camera is far."""
        errors = self.errors
        if errors.blur:
            depth = 1.0 / np.asarray(cv2.GaussianBlur(1.0 / depth, (0, 0), errors.blur), np.float64)
        if errors.shift or errors.shift_sigma:
            shift = errors.shift + errors.shift_sigma * _at(index, [*seed, _SHIFT], errors.scale_length)
            depth = 1.0 / np.maximum(1.0 / depth + shift, 1.0 / errors.farthest)
        return depth

    def _in_blob(self, seed: list[int], index: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Say which pixels (H, W) are outliers: where a smooth field is at its highest."""
        errors = self.errors
        field = video_noise([*seed, _OUTLIERS], index, shape, errors.outlier_length, errors.outlier_frames)
        return field > NormalDist().inv_cdf(1.0 - errors.outliers)


def _at(index: int, seed: list[int], length: float) -> float:
    """The value of a stationary process at a frame."""
    return float(stationary(seed, index + 1, length)[index])


def _blind() -> ContractError:
    return ContractError(
        "depth=simulated knows frames of recordings and not images; predict with DepthSensor, or call its "
        "depth(sequence, index)."
    )
