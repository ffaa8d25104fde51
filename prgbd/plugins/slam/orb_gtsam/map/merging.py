"""Merging of duplicate points: one for what several keyframes saw as different ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_LOW, match_by_projection
from prgbd.plugins.slam.orb_gtsam.map.map import Map

IntArray = NDArray[np.int64]

_RADIUS = 3.0


def merge_duplicates(slam_map: Map, camera: CameraModel, k: int, points: IntArray) -> int:
    """Project points into keyframe ``k``; where a keypoint fits, let it observe the point or merge it with its own.

    Args:
        slam_map: The map.
        camera: The camera.
        k: The keyframe.
        points: (P,) int64 points.

    Returns:
        Number of new observations and merges.
    """
    pts = slam_map.points
    seen = np.zeros(pts.count, np.bool_)
    own = slam_map.points_of(k)
    seen[own[own >= 0]] = True
    points = points[~seen[points] & ~pts.bad[points]]
    shown = camera.project(pts.xyz[points], pts.normal[points], pts.distance_range[points], slam_map.keyframes.cTw[k])
    inside = np.flatnonzero(shown.visible)
    points, level, uvr = points[inside], shown.level[inside], shown.uvr[inside]
    features = slam_map.features(k)
    found = match_by_projection(
        uvr,
        _RADIUS * camera.scales[level],
        (level - 1, level),
        pts.descriptor[points],
        features,
        camera.columns,
        limit=DISTANCE_LOW,
        slack=camera.right_slack(features.depth),
    )
    matched = found >= 0
    points, rows, uvr = points[matched], found[matched], uvr[matched]
    fits = camera.fits(features, rows, uvr)
    points, rows = points[fits], rows[fits]
    free = own[rows] < 0
    slam_map.observe(k, rows[free], points[free])
    rivals = own[rows[~free]]
    counts = slam_map.observation_counts(points[~free], double=True)
    rival_counts = slam_map.observation_counts(rivals, double=True)
    for mine, rival, more in zip(points[~free].tolist(), rivals.tolist(), rival_counts > counts, strict=True):
        if mine == rival or pts.bad[mine] or pts.bad[rival]:
            continue
        if more:
            slam_map.merge(mine, rival)
        else:
            slam_map.merge(rival, mine)
    return len(rows)
