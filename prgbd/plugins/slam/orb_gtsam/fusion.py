"""Fusion: one point for what several keyframes saw as different ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.mapping import Map
from prgbd.plugins.slam.orb_gtsam.matching import match_by_projection
from prgbd.plugins.slam.orb_gtsam.rig import Rig
from prgbd.plugins.slam.orb_gtsam.settings import Settings

IntArray = NDArray[np.int64]

_RADIUS = 3.0


def fuse_into(world: Map, rig: Rig, settings: Settings, k: int, points: IntArray) -> int:
    """Project points into keyframe ``k``; where a keypoint fits, let it observe the point or merge it with its own.

    Args:
        world: The map.
        rig: The camera.
        settings: Thresholds.
        k: The keyframe.
        points: (P,) int64 points.

    Returns:
        Number of new observations and merges.
    """
    pts = world.points
    seen = np.zeros(pts.count, np.bool_)
    own = world.points_of(k)
    seen[own[own >= 0]] = True
    points = points[~seen[points] & ~pts.bad[points]]
    shown = rig.project(pts.xyz[points], pts.normal[points], pts.distance_range[points], world.keyframes.cTw[k])
    inside = np.flatnonzero(shown.visible)
    points, level, uvr = points[inside], shown.level[inside], shown.uvr[inside]
    features = world.features(k)
    found = match_by_projection(
        uvr,
        _RADIUS * rig.scales[level],
        (level - 1, level),
        pts.descriptor[points],
        features,
        rig.columns,
        limit=settings.distance_low,
        slack=rig.right_slack(features.depth),
    )
    matched = found >= 0
    points, rows, uvr = points[matched], found[matched], uvr[matched]
    fits = rig.fits(features, rows, uvr)
    points, rows = points[fits], rows[fits]
    free = own[rows] < 0
    world.observe(k, rows[free], points[free])
    rivals = own[rows[~free]]
    counts = world.observation_counts(points[~free], double=True)
    rival_counts = world.observation_counts(rivals, double=True)
    for mine, rival, more in zip(points[~free].tolist(), rivals.tolist(), rival_counts > counts, strict=True):
        if mine == rival or pts.bad[mine] or pts.bad[rival]:
            continue
        if more:
            world.merge(mine, rival)
        else:
            world.merge(rival, mine)
    return len(rows)
