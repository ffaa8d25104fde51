"""``SensorErrors``: the options of the simulated depth sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from prgbd.core.option_ranges import NotNegative, Positive, Range, Seed
from prgbd.core.options import check_types

# Standard deviations of the logarithm of depth: with 2 one in three depths is wrong by a factor of seven or more.
LogSigma = Annotated[float, Range(0, 2)]
NEAREST = 0.1
"""Nearest depth that comes out, metres."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the simulated depth sensor, ``depth.*``; without any, depth is the true one.

    A pixel p of frame t measures the depth z of the truth as

        ``1 / z' = blurred(1 / z) + shift + a_t``,  ``log z_measured = log z' + bias + s_t + e_tp``

    with stationary processes s and a along the video that are common to all pixels of a frame, and an own error e of
    every pixel. A length is where the correlation has fallen to 1 / e; 0 draws every frame, or every pixel, anew.

    Attributes:
        scale_sigma: Standard deviation of s, the scale error of a frame.
        scale_length: Correlation length of s and a along the video, frames.
        own_sigma: Standard deviation of e, the own error of a pixel.
        own_length: Correlation length of e over the image, pixels.
        own_frames: Correlation length of e along the video at one place of the image, frames.
        shift: Constant shift of inverse depth, 1 / metres.
        shift_sigma: Standard deviation of a, the shift of a frame, 1 / metres.
        bias: Constant error of the logarithm of depth: 0.1 is 10 % too far.
        outliers: Share of the pixels that lie in blobs of wrong depth, which wander over the image.
        outlier_factor: What depth is multiplied by in a blob.
        outlier_length: Correlation length of the blobs over the image, pixels.
        outlier_frames: Correlation length of the blobs along the video, frames.
        blur: Standard deviation of the blur of inverse depth, pixels, which smears borders of things.
        farthest: Farthest depth that comes out, metres, as of a network.
        seed: Decides all errors, together with the name of the recording and the number of the frame.

    Raises:
        ConfigError: If a value cannot work.
    """

    scale_sigma: LogSigma = 0.0
    scale_length: NotNegative = 30.0
    own_sigma: LogSigma = 0.0
    own_length: NotNegative = 0.0
    own_frames: NotNegative = 0.0
    shift: float = 0.0
    shift_sigma: NotNegative = 0.0
    bias: Annotated[float, Range(-2, 2)] = 0.0
    outliers: Annotated[float, Range(0, 1, without=1)] = 0.0
    outlier_factor: Positive = 0.5
    outlier_length: NotNegative = 30.0
    outlier_frames: NotNegative = 10.0
    blur: NotNegative = 0.0
    farthest: Annotated[float, Range(NEAREST, without=NEAREST)] = 100.0
    seed: Seed = 0

    def __post_init__(self) -> None:
        check_types(self, "depth")
