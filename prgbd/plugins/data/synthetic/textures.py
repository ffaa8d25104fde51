"""Procedural textures, and their storage for anti-aliased look-up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEVELS = 6


class TextureAtlas:
    """Named square textures, each reduced separately along columns and rows ("rip maps").

    The separate reductions keep a surface seen at a flat angle, such as a road, sharp across and smooth along.
    """

    def __init__(self) -> None:
        self._names: dict[str, int] = {}
        self._sizes: list[int] = []
        self._chunks: list[NDArray[np.uint8]] = []
        self._offsets: list[NDArray[np.int64]] = []
        self._total = 0
        self._arrays: tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]] | None = None

    def add(self, name: str, image: NDArray[np.floating]) -> None:
        """Add an (S, S, 3) texture with values of 0..255, S a power of two >= 64."""
        size = image.shape[0]
        offsets = np.zeros((LEVELS, LEVELS), np.int64)
        rows = np.clip(image, 0, 255).astype(np.float32)
        for j in range(LEVELS):
            level = rows
            for i in range(LEVELS):
                offsets[j, i] = self._total
                chunk = np.clip(level + 0.5, 0, 255).astype(np.uint8).ravel()
                self._chunks.append(chunk)
                self._total += chunk.size
                level = 0.5 * (level[:, 0::2] + level[:, 1::2])
            rows = 0.5 * (rows[0::2] + rows[1::2])
        self._names[name] = len(self._sizes)
        self._sizes.append(size)
        self._offsets.append(offsets)

    def index(self, name: str) -> int:
        """Return the number of a texture."""
        return self._names[name]

    def size(self, name: str) -> int:
        """Return the side of a texture in texels."""
        return self._sizes[self._names[name]]

    def arrays(self) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]]:
        """Return all texels, the (T, LEVELS, LEVELS) offsets [row level, column level] and the (T,) sides.

        The atlas is complete then; what it was put together from is let go.
        """
        if self._arrays is None:
            texels = np.concatenate(self._chunks)
            self._arrays = texels, np.stack(self._offsets), np.array(self._sizes, np.int64)
            self._chunks = []
        return self._arrays
