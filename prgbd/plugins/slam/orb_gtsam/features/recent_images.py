"""The image pyramids of the last keyframes, kept for the alignment of patches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import resize_pixels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class RecentImages:
    """A ring of pyramids, so that memory does not grow with the map.

    Attributes:
        pixels: (N, S) uint8, the levels of every pyramid, finest first, one after the other and row by row.
        offset: (L,) where a level begins.
        width: (L,) its columns.
        height: (L,) its rows.

    Args:
        sizes: (columns, rows) of the levels, finest first.
        count: Number of keyframes that are kept.
    """

    def __init__(self, sizes: list[tuple[int, int]], count: int) -> None:
        self.width, self.height = np.array(sizes, np.int64).T.copy()
        areas = self.width * self.height
        self.offset: IntArray = np.concatenate([[0], np.cumsum(areas)[:-1]]).astype(np.int64)
        self.pixels = np.zeros((count, int(areas.sum())), np.uint8)
        self._keyframes = np.full(count, -1, np.int64)
        self._next = 0
        self._scale = np.stack([self.width[0] / self.width, self.height[0] / self.height], axis=1)

    def add(self, keyframe: int, pyramid: list[NDArray[np.uint8]]) -> None:
        """Keep the pyramid of a keyframe in place of the oldest one; levels that are missing stay black."""
        slot = self._next
        self._next = (slot + 1) % len(self.pixels)
        self._keyframes[slot] = keyframe
        self.pixels[slot] = 0
        for octave, level in enumerate(pyramid):
            first = self.offset[octave]
            self.pixels[slot, first : first + level.size] = level.reshape(-1)

    def slots(self, keyframes: int) -> IntArray:
        """Return where the pyramids of keyframes 0 to ``keyframes`` - 1 lie, -1 for those that are not kept."""
        found = np.full(keyframes, -1, np.int64)
        known = np.flatnonzero((self._keyframes >= 0) & (self._keyframes < keyframes))
        found[self._keyframes[known]] = known
        return found

    def scale(self, octave: NDArray[np.integer]) -> FloatArray:
        """Return how many pixels of the image a pixel of a level is wide and high, (N, 2)."""
        return np.asarray(self._scale[octave])

    def to_level(self, uv: FloatArray, octave: NDArray[np.integer]) -> FloatArray:
        """Move pixels (N, 2) of the image to pixels of its levels."""
        return np.ascontiguousarray(resize_pixels(uv, 1.0 / self.scale(octave)))

    def to_image(self, xy: FloatArray, octave: NDArray[np.integer]) -> FloatArray:
        """Move pixels (N, 2) of levels to pixels of the image."""
        return np.ascontiguousarray(resize_pixels(xy, self.scale(octave)))
