"""From the grey levels of image files with more than 8 bits to 8 bits, by one rule for a whole recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEPTHS = (8, 10, 12, 14, 16)  # bits that cameras use in files of 16
HIGHEST = 99.99  # per cent of the values; those above may be pixels that are stuck
LOWEST = 0.01
NARROW = 1 / 16  # of its bits' range: a recording that uses less (thermal cameras) is stretched
MARGIN = 0.5  # of the range seen, left below and above for images that were not looked at


@dataclass(frozen=True)
class Levels:
    """The range of values that becomes 0 to 255.

    Attributes:
        low: The value that becomes 0.
        high: The value that would become 256.
    """

    low: float = 0.0
    high: float = 65536.0

    def to_8_bits(self, image: NDArray) -> NDArray[np.uint8]:
        """Return an image of any type with 8 bits; one that has them is returned as it is. NaN becomes 0."""
        if image.dtype == np.uint8:
            return image
        if image.dtype == np.uint16:
            return self._scaled(np.arange(65536))[image]
        return self._scaled(np.nan_to_num(image.astype(np.float64), nan=self.low))

    def _scaled(self, values: NDArray) -> NDArray[np.uint8]:
        return np.clip((values - self.low) * (256 / (self.high - self.low)), 0, 255).astype(np.uint8)


ALL_LEVELS = Levels()


def levels_of(images: Sequence[NDArray]) -> tuple[Levels, str]:
    """Return the range of values of a recording from some images of it, and what was understood, in words.

    Values of 10, 12 or 14 bits in files of 16 become 8 bits by leaving the lowest ones out, as full 16 bits do;
    the few levels of a thermal camera are stretched. Floats are taken as 0 to 1 where none is larger, else as levels.

    Args:
        images: Images of the recording as they are in the files, spread over it.

    Returns:
        The range, and a clause, empty where nothing was scaled that users would want to know of.
    """
    deep = [image[np.isfinite(image)] for image in images if image.dtype != np.uint8]
    values = [image for image in deep if image.size]
    if not values:
        return ALL_LEVELS, ""
    low = min(float(np.percentile(image, LOWEST)) for image in values)
    high = max(float(np.percentile(image, HIGHEST)) for image in values)
    if values[0].dtype.kind == "f" and low >= 0 and high <= 1:
        return Levels(0.0, 1.0), "images of floats from 0 to 1"
    bits = next((bits for bits in DEPTHS if low >= 0 and high < 2**bits), None)
    if bits is not None and (high - low >= NARROW * 2**bits or bits == DEPTHS[0]):
        return Levels(0.0, 2.0**bits), "" if bits == DEPTHS[-1] else f"images of {bits} bits scaled to 8"
    if high <= low:
        return ALL_LEVELS, ""
    stretched = Levels(low - MARGIN * (high - low), high + MARGIN * (high - low))
    return stretched, f"images with values {low:.0f} to {high:.0f} stretched to 8 bits, all by one factor"
