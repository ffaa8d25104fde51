"""The covisibility graph: which keyframes see the same points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.map.map import Map

IntArray = NDArray[np.int64]


class CovisibilityGraph:
    """Remembers covisible keyframes between two changes of the map.

    Attributes:
        least: Common points that make two keyframes neighbours.
    """

    def __init__(self, slam_map: Map, least: int) -> None:
        self._map, self.least = slam_map, least
        self._known: dict[int, IntArray] = {}

    def clear(self) -> None:
        """Forget all, after the map changed."""
        self._known.clear()

    def of(self, k: int) -> IntArray:
        """Return the keyframes covisible with ``k``, most common points first."""
        if k not in self._known:
            self._known[k] = self._map.covisible(k, self.least)[0]
        return self._known[k]
