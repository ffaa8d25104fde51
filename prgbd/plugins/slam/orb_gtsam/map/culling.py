"""What leaves the map: new points that do not last, wrong observations and depths, redundant keyframes."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.kernels import kernel
from prgbd.plugins.slam.orb_gtsam.map.map import Map

IntArray = NDArray[np.int64]

# ORB-SLAM2 (LocalMapping::MapPointCulling): share of the frames that should see a new point in which it must be found.
MIN_FOUND_RATIO = 0.25
# A point may leave probation this many keyframes after its creation (LocalMapping::MapPointCulling).
_PROBATION = 3
# Keyframes after the first in which a point must have been seen often enough.
_JUDGED_AFTER = 2


def cull_new_points(slam_map: Map, k: int, *, mono: bool) -> None:
    """Remove points on probation that are rarely found or seldom observed (LocalMapping::MapPointCulling).

    Args:
        slam_map: The map.
        k: The newest keyframe.
        mono: Whether there is no depth; with depth, an observation that has it counts twice.
    """
    pts = slam_map.points
    least = 2 if mono else 3
    kept: deque[tuple[int, IntArray]] = deque()
    for created, points in slam_map.probation:
        points = points[~pts.bad[points]]
        bad = pts.found[points] < MIN_FOUND_RATIO * pts.visible[points]
        if k - created >= _JUDGED_AFTER:
            bad |= slam_map.observation_counts(points, double=not mono) <= least
        slam_map.remove_points(points[bad])
        slam_map.counts.points_culled += int(bad.sum())
        if k - created < _PROBATION:
            kept.append((created, points[~bad]))
    slam_map.probation = kept


def drop_depths(slam_map: Map, disagreeing: IntArray) -> None:
    """Make observations ((M, 3) as from ``Map.observations``) monocular for good: their depth is wrong."""
    slam_map.keyframes.u_right[disagreeing[:, 0], disagreeing[:, 1]] = -1.0
    slam_map.counts.depths_rejected += len(disagreeing)


def drop_observations(slam_map: Map, outliers: IntArray, *, double: bool) -> None:
    """Remove observations ((M, 3) as from ``Map.observations``), and points that keep at most two.

    With ``double``, observations that have depth count twice.
    """
    points = np.unique(slam_map.keyframes.point[outliers[:, 0], outliers[:, 1]])
    points = points[points >= 0]
    slam_map.forget(np.ascontiguousarray(outliers[:, 0]), np.ascontiguousarray(outliers[:, 1]))
    few = slam_map.observation_counts(points, double=double) <= 2
    slam_map.remove_points(points[few])


def is_redundant(slam_map: Map, k: int, share: float, close: float) -> bool:
    """Whether three others see more than ``share`` of a keyframe's points as well or better.

    Only points whose measured depth is at most ``close`` count; all do with 0 (LocalMapping::KeyFrameCulling).
    """
    kf = slam_map.keyframes
    found = _redundant_share(kf.point, kf.following, kf.octave, kf.depth, slam_map.points.head, k, close)
    return bool(found > share)


@kernel()
def _redundant_share(
    point_of: np.ndarray,
    following: np.ndarray,
    octave: np.ndarray,
    depth: np.ndarray,
    head: np.ndarray,
    k: int,
    close: float,
) -> float:
    """Share of a keyframe's (close) points that at least three others see at the same or a finer scale."""
    capacity = point_of.shape[1]
    flat_next, flat_octave = following.reshape(-1), octave.reshape(-1)
    points, redundant = 0, 0
    for i in range(capacity):
        p = point_of[k, i]
        if p < 0 or (close > 0 and (depth[k, i] <= 0 or depth[k, i] > close)):
            continue
        points += 1
        others, at = 0, head[p]
        while at >= 0:
            if at // capacity != k and flat_octave[at] <= octave[k, i] + 1:
                others += 1
            at = flat_next[at]
        redundant += others >= 3
    return redundant / points if points > 0 else 0.0
