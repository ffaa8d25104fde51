"""Relocalisation: the pose of a lost frame in any map, by appearance, PnP, and then projection."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_HIGH
from prgbd.plugins.slam.orb_gtsam.map.keyframe_lookup import KeyframeLookup
from prgbd.plugins.slam.orb_gtsam.tracking.local_map import match_keyframe, match_local_map
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.tracking.tracker import MIN_INLIERS_POSE, MIN_MATCHES_REFERENCE, Tracker

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

# ORB-SLAM2 (Tracking::Relocalization): ratio test against a candidate.
RATIO = 0.75
_PNP_PIXELS = 5.0
_PNP_ITERATIONS = 300
# Covisible keyframes whose points are looked for together with a candidate's own.
_AROUND = 5
# Factors on the search radius once there is a pose, as it gets better.
_NARROWING = (4.0, 1.5)


class Relocaliser:
    """Finds lost frames in the map (Tracking::Relocalization): near the last keyframe, then wherever it looks alike.

    Args:
        tracker: Its reference keyframe is where the search starts; gets another one when a frame is found.
        database: Finds keyframes of all maps by appearance.
    """

    def __init__(self, tracker: Tracker, database: KeyframeLookup) -> None:
        self.tracker, self.database = tracker, database
        self.settings, self.map, self.camera = tracker.settings, tracker.map, tracker.camera

    def sees(self, frame: TrackedFrame) -> bool:
        """Whether a frame has enough keypoints to be found at all; a black image does not."""
        return len(frame.features) >= self.settings.tracking.min_inliers_recovered

    def find(self, frame: TrackedFrame) -> int:
        """Try to find a lost frame in any map; the map it is found in becomes the current one.

        Args:
            frame: The frame; gets pose and matches.

        Returns:
            Inliers, 0 if the frame stays lost.
        """
        if not self.sees(frame):
            return 0
        tracker, slam_map = self.tracker, self.map
        for k in self._candidates(frame):
            if not self._pose_against(frame, k):
                continue
            before = tracker.reference, tracker.recovered_at
            tracker.reference, tracker.recovered_at = k, frame.ordinal
            inliers = tracker.from_local_map(frame, self.settings.tracking.min_inliers_recovered)
            if inliers:
                slam_map.current_map = int(slam_map.keyframes.map_id[tracker.reference])
                return inliers
            tracker.reference, tracker.recovered_at = before
        # A new map may start from this frame; what was tried here must not tie it to the old ones.
        frame.clear()
        return 0

    def _candidates(self, frame: TrackedFrame) -> list[int]:
        """Return where the frame was last seen and the places that look like it, in turns."""
        slam_map, tracker, limit = self.map, self.tracker, self.settings.tracking.recovery_keyframes
        bad = slam_map.keyframes.bad
        recent: list[int] = []
        if tracker.reference >= 0:
            reference = slam_map.successor(tracker.reference)
            latest = slam_map.alive(int(slam_map.keyframes.map_id[reference]))[::-1]
            recent = [reference, *latest[:2].tolist(), *tracker.covisibility.of(reference)[:2].tolist()]
        alike, _ = self.database.query(frame.features.descriptor, count=3 * limit)
        chosen: dict[int, None] = {}
        # Of keyframes next to each other one is enough: the points around it are looked for as well.
        covered: set[int] = set()
        for k in alike.tolist():
            if k not in covered and not bad[k]:
                chosen[k] = None
                covered.update((k, *tracker.covisibility.of(k)[:_AROUND].tolist()))
        mixed = [k for pair in zip(recent, chosen, strict=False) for k in pair]
        ordered = dict.fromkeys([*mixed, *recent, *chosen])
        return [k for k in ordered if not bad[k]][:limit]

    def _pose_against(self, frame: TrackedFrame, k: int) -> bool:
        """Find the pose of a frame from the points of keyframe ``k`` and of those around it."""
        slam_map, camera = self.map, self.camera
        matches = match_keyframe(slam_map, frame, k, limit=DISTANCE_HIGH, ratio=RATIO)
        if matches < MIN_MATCHES_REFERENCE:
            return False
        guess = self._pnp(frame)
        if guess is None or frame.estimate_pose(slam_map, camera, guess) < MIN_INLIERS_POSE:
            return False
        frame.drop_outliers()
        around = slam_map.seen_by(np.append(self.tracker.covisibility.of(k)[:_AROUND], k))
        for factor in _NARROWING:
            match_local_map(slam_map, frame, around, camera, factor=factor, gate=self.settings.depth.gate)
            frame.estimate_pose(slam_map, camera, frame.cTw)
            frame.drop_outliers()
        return len(frame.matched()) >= MIN_INLIERS_POSE

    def _pnp(self, frame: TrackedFrame) -> FloatArray | None:
        """Return the pose that most of a frame's matches agree with, and forget the others."""
        matched = frame.matched()
        # OpenCV seeds this RANSAC with a constant, so equal input gives equal output.
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            self.map.points.xyz[frame.points[matched]],
            frame.features.uv[matched].astype(np.float64),
            self.camera.pinhole.K,
            None,
            iterationsCount=_PNP_ITERATIONS,
            reprojectionError=_PNP_PIXELS,
            confidence=0.999,
            flags=cv2.SOLVEPNP_AP3P,
        )
        if not ok or inliers is None or len(inliers) < MIN_INLIERS_POSE:
            return None
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(rotation)[0]
        pose[:3, 3] = translation.ravel()
        frame.points[np.setdiff1d(matched, matched[inliers.ravel()])] = -1
        return pose if np.isfinite(pose).all() else None
