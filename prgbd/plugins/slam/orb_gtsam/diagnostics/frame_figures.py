"""Figures about single frames and the growing map, for the report and for people who watch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from prgbd.core.slam import SlamView
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel, measurements
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.map import Map

if TYPE_CHECKING:
    from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame


@dataclass(frozen=True)
class DepthAgreement:
    """How the measured depth of a frame's inliers fits the map; NaN without measured depth.

    Attributes:
        ratio: Median of measured depth over map depth. Far from 1, or wandering, it says that the depth's scale drifts
            from frame to frame.
        spread: Robust standard deviation (1.4826 MAD) of the logarithm of that ratio within the frame: the relative
            error of single depths.
        rejected: Share of the stereo observations whose pixel agrees with the map but whose depth does not, by the
            chi-square test with the depth's own uncertainty.
    """

    ratio: float = float("nan")
    spread: float = float("nan")
    rejected: float = float("nan")


def depth_agreement(slam_map: Map, camera: CameraModel, frame: TrackedFrame) -> DepthAgreement:
    """Compare the measured depth of a tracked frame with the map."""
    rows = frame.inliers()
    rows = rows[frame.features.depth[rows] > 0]
    p = slam_map.points.xyz[frame.points[rows]] @ frame.cTw[:3, :3].T + frame.cTw[:3, 3]
    front = p[:, 2] > 1e-6
    rows, p = rows[front], p[front]
    if len(rows) == 0:
        return DepthAgreement()
    ratio = frame.features.depth[rows] / p[:, 2]
    logs = np.log(ratio)
    spread = 1.4826 * float(np.median(np.abs(logs - np.median(logs))))
    seen = camera.pinhole.project(p)
    stereo = frame.features.u_right[rows] >= 0
    fits = camera.fits(frame.features, rows, measurements(seen, seen[:, 0] - camera.bf / p[:, 2]), depth_counts=True)
    rejected = float(np.mean(~fits[stereo])) if stereo.any() else float("nan")
    return DepthAgreement(float(np.median(ratio)), spread, rejected)


def depth_figures(agreements: list[DepthAgreement]) -> dict[str, list[float | None]]:
    """Return the figures of all frames as plain lists for the statistics, None where there is none."""

    def plain(values: list[float]) -> list[float | None]:
        return [None if np.isnan(value) else round(value, 4) for value in values]

    return {
        "depth_ratio": plain([a.ratio for a in agreements]),
        "depth_spread": plain([a.spread for a in agreements]),
        "depth_rejected": plain([a.rejected for a in agreements]),
    }


def map_sizes(slam_map: Map) -> dict[str, int]:
    """Return how many keyframes, points and unconnected maps there are now; the caller holds the map's lock."""
    kf, pts = slam_map.keyframes, slam_map.points
    alive = ~kf.bad[: kf.count]
    return {
        "keyframes": int(np.count_nonzero(alive)),
        "points": int(np.count_nonzero(~pts.bad[: pts.count])),
        "maps": len(np.unique(kf.map_id[: kf.count][alive])),
    }


def view_of(slam_map: Map, frame: TrackedFrame | None) -> SlamView:
    """Copy what people want to see of the map and of the present frame (None while it has no pose)."""
    kf, pts = slam_map.keyframes, slam_map.points
    alive = np.flatnonzero(~kf.bad[: kf.count])
    points = np.flatnonzero(~pts.bad[: pts.count])
    keypoints = np.zeros((0, 2), np.float32) if frame is None else frame.features.uv[frame.inliers()]
    return SlamView(inverse(kf.cTw[alive]), pts.xyz[points], pts.rgb[points], keypoints)
