"""The part of the map around a frame, and its matching to the frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_HIGH, match_by_descriptor, match_by_projection
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame

IntArray = NDArray[np.int64]

# ORB-SLAM2 (ORBmatcher::RadiusByViewingCos): a point seen from its usual side is found nearer to its prediction.
_FRONTAL_COSINE = 0.998
_FRONTAL_RADIUS = 2.5
_OBLIQUE_RADIUS = 4.0
# ORB-SLAM2 (Tracking::SearchLocalPoints): ratio test against the local map.
RATIO = 0.8
# How many of the keyframes that share points bring in their own neighbours.
_EXPANDED = 10


@dataclass(frozen=True)
class LocalMap:
    """What a frame is matched against.

    Attributes:
        reference: The keyframe that shares most points with the frame.
        keyframes: (K,) int64.
        points: (P,) int64.
    """

    reference: int
    keyframes: IntArray
    points: IntArray


def local_map(slam_map: Map, frame: TrackedFrame, covisibility: CovisibilityGraph, most: int) -> LocalMap | None:
    """Collect the keyframes that see the frame's points, one neighbour of each, and all their points.

    Args:
        slam_map: The map.
        frame: The frame with matches.
        covisibility: Covisible keyframes.
        most: Keyframes at most.

    Returns:
        The local map, or None if no keyframe shares a point with the frame.
    """
    counts = covisibility.common(frame.points)
    order = np.flatnonzero(counts)
    order = order[np.argsort(-counts[order], kind="stable")][:most]
    if len(order) == 0:
        return None
    chosen = [int(k) for k in order]
    known = set(chosen)
    for k in chosen[:_EXPANDED]:
        if len(chosen) >= most:
            break
        fresh = next((int(n) for n in covisibility.of(k)[:10] if int(n) not in known), None)
        if fresh is not None:
            chosen.append(fresh)
            known.add(fresh)
    keyframes = np.array(chosen, np.int64)
    return LocalMap(chosen[0], keyframes, slam_map.seen_by(keyframes))


def match_keyframe(slam_map: Map, frame: TrackedFrame, k: int, *, limit: int, ratio: float) -> int:
    """Forget the frame's matches and match it to the points of keyframe ``k`` by descriptors alone.

    Args:
        slam_map: The map.
        frame: The frame.
        k: The keyframe.
        limit: Largest Hamming distance.
        ratio: Largest ratio between the best and the second distance.

    Returns:
        Number of matches.
    """
    points = slam_map.points_of(k)
    rows = np.flatnonzero(points >= 0)
    keyframe = slam_map.features(k)
    frame.clear()
    found = match_by_descriptor(
        keyframe.descriptor[rows], keyframe.angle[rows], frame.features, limit=limit, ratio=ratio
    )
    return frame.match(found, points[rows])


def match_local_map(
    slam_map: Map, frame: TrackedFrame, points: IntArray, camera: CameraModel, *, factor: float, gate: bool
) -> int:
    """Match points that the frame does not have yet by projection, and count all that should be visible.

    Args:
        slam_map: The map.
        frame: The frame with a pose; gets more matches.
        points: (P,) int64 candidates.
        camera: The camera.
        factor: Multiplies the search radius.
        gate: Whether matches must agree with the measured depth.

    Returns:
        Number of new matches.
    """
    pts = slam_map.points
    mine = frame.points[frame.points >= 0]
    pts.visible[mine] += 1
    unmatched = np.ones(pts.count, np.bool_)
    unmatched[mine] = False
    candidates = points[unmatched[points] & ~pts.bad[points]]
    seen = camera.project(pts.xyz[candidates], pts.normal[candidates], pts.distance_range[candidates], frame.cTw)
    inside = np.flatnonzero(seen.visible)
    candidates = candidates[inside]
    pts.visible[candidates] += 1
    level = seen.level[inside]
    radius = np.where(seen.cosine[inside] > _FRONTAL_COSINE, _FRONTAL_RADIUS, _OBLIQUE_RADIUS) * factor
    uvr = seen.uvr[inside]
    if not gate:
        uvr[:, 2] = -1.0
    found = match_by_projection(
        uvr,
        radius * camera.scales[level],
        (level - 1, level),
        pts.descriptor[candidates],
        frame.features,
        camera.columns,
        limit=DISTANCE_HIGH,
        ratio=RATIO,
        taken=frame.points >= 0,
        slack=camera.right_slack(frame.features.depth),
    )
    return frame.match(found, candidates)
