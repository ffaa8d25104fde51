"""Recovery of lost tracking against nearby keyframes: descriptors, PnP, then projection."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.frames import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.local_map import match_local_map
from prgbd.plugins.slam.orb_gtsam.matching import match_by_descriptor
from prgbd.plugins.slam.orb_gtsam.tracking import Tracker

IntArray = NDArray[np.int64]

_PNP_PIXELS = 5.0
_PNP_ITERATIONS = 300


def recover(tracker: Tracker, frame: TrackedFrame) -> int:
    """Try to find a lost frame in the map.

    Args:
        tracker: Its reference keyframe is where the search starts.
        frame: The frame; gets pose and matches.

    Returns:
        Inliers, 0 if the frame stays lost.
    """
    settings = tracker.settings
    for k in _candidates(tracker):
        if not _pose_against(tracker, frame, k):
            continue
        tracker.reference = k
        before, tracker.recovered_at = tracker.recovered_at, frame.ordinal
        inliers = tracker.from_local_map(frame, settings.min_inliers_recovered)
        if inliers:
            return inliers
        tracker.recovered_at = before
    return 0


def _candidates(tracker: Tracker) -> list[int]:
    """The reference keyframe and its neighbours, the latest ones, then others spread over the map."""
    world, limit = tracker.world, tracker.settings.recovery_keyframes
    alive = world.alive()
    if len(alive) == 0:
        return []
    reference = world.successor(tracker.reference)
    near = [reference, *tracker.near.of(reference)[:4].tolist(), *alive[::-1][:4].tolist()]
    spread = alive[np.linspace(0, len(alive) - 1, limit).astype(np.int64)].tolist()
    allowed = set(alive.tolist())
    return [k for k in dict.fromkeys([*near, *spread]) if k in allowed][:limit]


def _pose_against(tracker: Tracker, frame: TrackedFrame, k: int) -> bool:
    world, rig, settings = tracker.world, tracker.rig, tracker.settings
    points = world.points_of(k)
    rows = np.flatnonzero(points >= 0)
    keyframe = world.features(k)
    frame.clear()
    found = match_by_descriptor(
        keyframe.descriptor[rows],
        keyframe.angle[rows],
        frame.features,
        limit=settings.distance_high,
        ratio=settings.ratio_recovery,
    )
    if frame.match(found, points[rows]) < settings.min_matches_reference:
        return False
    matched = frame.matched()
    ok, rotation, translation, inliers = cv2.solvePnPRansac(
        world.points.xyz[frame.points[matched]],
        frame.features.uv[matched].astype(np.float64),
        rig.camera.K,
        None,
        iterationsCount=_PNP_ITERATIONS,
        reprojectionError=_PNP_PIXELS,
        confidence=0.999,
        flags=cv2.SOLVEPNP_EPNP,
    )
    if not ok or inliers is None or len(inliers) < settings.min_inliers_pose:
        return False
    guess = np.eye(4)
    guess[:3, :3] = cv2.Rodrigues(rotation)[0]
    guess[:3, 3] = translation.ravel()
    kept = matched[inliers.ravel()]
    away = np.setdiff1d(matched, kept)
    frame.points[away] = -1
    if frame.estimate_pose(world, rig, guess) < settings.min_inliers_pose:
        return False
    frame.drop_outliers()
    for factor in (4.0, 1.5):
        match_local_map(world, frame, points[rows], rig, settings, factor=factor)
        frame.estimate_pose(world, rig, frame.cTw)
        frame.drop_outliers()
    return len(frame.matched()) >= settings.min_inliers_pose
