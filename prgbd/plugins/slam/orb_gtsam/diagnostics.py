"""Figures about single frames for the report."""

from __future__ import annotations

import numpy as np

from prgbd.plugins.slam.orb_gtsam.frames import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.mapping import Map


def depth_ratio(world: Map, frame: TrackedFrame) -> float:
    """Return the median of measured depth over map depth of a frame's inliers; NaN without measured depth.

    Far from 1, or wandering, it says that the depth's scale drifts from frame to frame.
    """
    rows = frame.inliers()
    measured = frame.features.depth[rows]
    rows, measured = rows[measured > 0], measured[measured > 0]
    if len(rows) == 0:
        return float("nan")
    z = world.points.xyz[frame.points[rows]] @ frame.cTw[2, :3] + frame.cTw[2, 3]
    front = z > 1e-6
    return float(np.median(measured[front] / z[front])) if front.any() else float("nan")
