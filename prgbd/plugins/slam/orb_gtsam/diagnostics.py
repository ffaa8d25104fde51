"""Figures about single frames and the growing map, for the report and for people who watch."""

from __future__ import annotations

import numpy as np

from prgbd.core.slam import SlamView
from prgbd.plugins.slam.orb_gtsam.frames import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.lie import inverse
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


def map_sizes(world: Map) -> dict[str, int]:
    """Return how many keyframes, points and unconnected maps there are now; the caller holds the map's lock."""
    kf, pts = world.keyframes, world.points
    alive = ~kf.bad[: kf.count]
    return {
        "keyframes": int(np.count_nonzero(alive)),
        "points": int(np.count_nonzero(~pts.bad[: pts.count])),
        "maps": len(np.unique(kf.map_id[: kf.count][alive])),
    }


def view_of(world: Map, frame: TrackedFrame | None) -> SlamView:
    """Copy what people want to see of the map and of the present frame (None while it has no pose)."""
    kf, pts = world.keyframes, world.points
    alive = np.flatnonzero(~kf.bad[: kf.count])
    points = np.flatnonzero(~pts.bad[: pts.count])
    keypoints = np.zeros((0, 2), np.float32) if frame is None else frame.features.uv[frame.inliers()]
    return SlamView(inverse(kf.cTw[alive]), pts.xyz[points], pts.rgb[points], keypoints)
