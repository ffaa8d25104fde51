"""Standard deviations of log depth as bytes, on a logarithmic scale: a quarter of the space that depth takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SMALLEST, LARGEST = 0.002, 10.0
"""A fifth of a per cent, which no network reaches, and e to the 10: what lies beyond is told as these."""
_STEPS = 255


def to_codes(sigma: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return bytes that differ from the deviations by at most 1.7 per cent within ``SMALLEST`` and ``LARGEST``."""
    level = np.log(np.clip(sigma, SMALLEST, LARGEST) / SMALLEST) / np.log(LARGEST / SMALLEST)
    return np.rint(_STEPS * level).astype(np.uint8)


def from_codes(codes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the deviations of ``to_codes``, float32."""
    return _DEVIATIONS[codes]


_DEVIATIONS = (SMALLEST * (LARGEST / SMALLEST) ** (np.arange(_STEPS + 1) / _STEPS)).astype(np.float32)
