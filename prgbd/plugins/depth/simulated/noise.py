"""Noise with a known correlation, every value of which follows from its seed and its place alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Floats = NDArray[np.float64]


def stationary(seed: Sequence[int], count: int, length: float) -> Floats:
    """Draw a stationary Gaussian process of unit variance, an Ornstein-Uhlenbeck process at whole times.

    Args:
        seed: Whole numbers; the first values of a longer process are those of a shorter one.
        count: How many values.
        length: Steps after which the correlation has fallen to 1 / e; 0 for independent values.

    Returns:
        (count,) values.
    """
    kept = math.exp(-1.0 / length) if length else 0.0
    drawn = np.random.default_rng(seed).standard_normal(count)
    drawn[1:] *= math.sqrt(1.0 - kept * kept)
    made: Floats = lfilter([1.0], [1.0, -kept], drawn)
    return made


def image_noise(seed: Sequence[int], shape: tuple[int, int], length: float) -> Floats:
    """Draw a Gaussian field of unit variance with the correlation ``exp(-(distance / length) ** 2)``.

    Args:
        seed: Whole numbers.
        shape: (height, width) pixels.
        length: Distance where the correlation has fallen to 1 / e, pixels; 0 for white noise.

    Returns:
        (height, width) values.
    """
    rng = np.random.default_rng(seed)
    if not length:
        return rng.standard_normal(shape)
    # White noise that is blurred by a Gaussian has twice its variance in the exponent of the correlation.
    sigma = length / 2.0
    reach = math.ceil(4.0 * sigma)
    kernel = cv2.getGaussianKernel(2 * reach + 1, sigma)
    white = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach))
    blurred = cv2.sepFilter2D(white, -1, kernel, kernel)[reach : reach + shape[0], reach : reach + shape[1]]
    made: Floats = blurred / np.square(kernel).sum()
    return made


def video_noise(seed: Sequence[int], frame: int, shape: tuple[int, int], length: float, frames: float) -> Floats:
    """Draw the noise of a frame of a video; like ``image_noise``, with correlation along the video.

    Independent fields stand ``frames`` apart and turn into each other on a circle, which keeps the variance. The mean
    correlation of frames so far apart is 1 / pi, and none is left after twice as many.

    Args:
        seed: Whole numbers.
        frame: Number of the frame.
        shape: (height, width) pixels.
        length: Correlation length over the image, pixels; 0 for white noise.
        frames: Correlation length along the video; 0 for independent frames.

    Returns:
        (height, width) values.
    """
    if not frames:
        return image_noise([*seed, frame], shape, length)
    knot, way = divmod(frame / frames, 1.0)
    before, after = (image_noise([*seed, int(knot) + step], shape, length) for step in (0, 1))
    return math.cos(way * math.pi / 2) * before + math.sin(way * math.pi / 2) * after
