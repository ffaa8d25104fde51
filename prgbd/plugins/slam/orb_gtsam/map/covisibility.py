"""The covisibility graph: which keyframes see the same points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_kernels import common_points

IntArray = NDArray[np.int64]

# ORB-SLAM2 (KeyFrame::UpdateConnections): common points that make two keyframes neighbours.
LEAST_COMMON = 15


class CovisibilityGraph:
    """Finds covisible keyframes, and remembers them between two changes of the map.

    Args:
        slam_map: The map.
        least: Common points that make two keyframes neighbours.
    """

    def __init__(self, slam_map: Map, least: int = LEAST_COMMON) -> None:
        self.map, self.least = slam_map, least
        self._known: dict[int, IntArray] = {}

    def clear(self) -> None:
        """Forget all, after the map changed."""
        self._known.clear()

    def of(self, k: int) -> IntArray:
        """Return the keyframes covisible with ``k``, most common points first."""
        if k not in self._known:
            self._known[k] = self.ranked(k, self.least)[0]
        return self._known[k]

    def ranked(self, k: int, least: int) -> tuple[IntArray, IntArray]:
        """Return the keyframes that share at least ``least`` points with ``k`` now, most first, and how many.

        Where none reaches ``least``, the best one is returned, as in ORB-SLAM2.
        """
        weights = self.common(self.map.points_of(k))
        weights[k] = 0
        order = np.flatnonzero(weights)
        order = order[np.argsort(-weights[order], kind="stable")]
        strong = order[weights[order] >= least]
        chosen = strong if len(strong) else order[:1]
        return chosen, weights[chosen]

    def common(self, points: IntArray) -> IntArray:
        """Return how many of some points (-1 for none) every keyframe sees now, (keyframes,) int64."""
        kf = self.map.keyframes
        return common_points(points, kf.following, self.map.points.head, kf.count, self.map.capacity)
