"""Tracking: the pose of every frame from the previous frame, the reference keyframe and the local map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_HIGH, DISTANCE_LOW, match_by_projection
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.settings import Settings
from prgbd.plugins.slam.orb_gtsam.tracking.local_map import local_map, match_keyframe, match_local_map
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# ORB-SLAM2 (Tracking::TrackWithMotionModel): ratio test, search radius in pixels at the finest level, and the matches
# below which the window is widened, then the motion model given up.
RATIO_MOTION, WINDOW_MOTION, MIN_MATCHES_MOTION = 0.9, 15.0, 20
# ORB-SLAM2 (Tracking::TrackReferenceKeyFrame): ratio test, and the matches that it needs.
RATIO_REFERENCE, MIN_MATCHES_REFERENCE = 0.7, 15
# The same: inliers needed after the first pose optimisation; and after the local map (Tracking::TrackLocalMap).
MIN_INLIERS_POSE, MIN_INLIERS_MAP = 10, 30
# ORB-SLAM2 (Tracking::SearchLocalPoints): wider windows with depth, and just after relocalisation.
FACTOR_WITH_DEPTH, _FACTOR_AFTER_RECOVERY = 3.0, 5.0


@dataclass
class LastFrame:
    """What tracking keeps of the previous frame: itself, and its pose relative to a keyframe of that scale."""

    frame: TrackedFrame
    reference: int
    cTref: FloatArray
    scale: float


class Tracker:
    """Finds the pose of each frame in the map; changes nothing there but the visibility counts.

    Args:
        settings: Thresholds.
        camera: The camera.
        slam_map: The map.
        covisibility: Covisible keyframes.
    """

    def __init__(self, settings: Settings, camera: CameraModel, slam_map: Map, covisibility: CovisibilityGraph) -> None:
        self.settings, self.camera, self.map, self.covisibility = settings, camera, slam_map, covisibility
        self.last: LastFrame | None = None
        self.velocity: FloatArray | None = None
        self.reference = -1
        self.recovered_at = -(1 << 30)

    def last_pose(self) -> FloatArray:
        """Return the pose of the last tracked frame, corrected with its reference keyframe."""
        assert self.last is not None
        return self._in_present_units(self.last.cTref) @ self.map.pose_of(self.last.reference)

    def predicted(self) -> FloatArray | None:
        """Return the pose that the last motion leads to, or None if it is not known."""
        return None if self.velocity is None else self._in_present_units(self.velocity) @ self.last_pose()

    def _in_present_units(self, motion: FloatArray) -> FloatArray:
        """Return a motion of the time of the last frame in the units that the map has there now."""
        assert self.last is not None
        out: FloatArray = motion.copy()
        out[:3, 3] *= self.map.keyframes.scale[self.last.reference] / self.last.scale
        return out

    def track(self, frame: TrackedFrame) -> int:
        """Find the pose of a frame; return its inliers, 0 if it is lost."""
        self.reference = self.map.successor(self.reference)
        found = self.velocity is not None and self._from_motion(frame)
        found = found or self._from_reference(frame)
        found = found or self._from_wide_search(frame)
        return self.from_local_map(frame, MIN_INLIERS_MAP) if found else 0

    def remember(self, frame: TrackedFrame) -> None:
        """Take a tracked frame as the previous one of the next."""
        if self.last is not None:
            self.velocity = frame.cTw @ inverse(self.last_pose())
        self.refer(frame)

    def refer(self, frame: TrackedFrame) -> None:
        """Keep ``frame`` relative to the reference keyframe, as the previous frame."""
        self.reference = self.map.successor(self.reference)
        cTref = frame.cTw @ inverse(self.map.keyframes.cTw[self.reference])
        self.last = LastFrame(frame, self.reference, cTref, float(self.map.keyframes.scale[self.reference]))

    def from_local_map(self, frame: TrackedFrame, least: int) -> int:
        """Match the local map, optimise and judge; return the inliers, 0 if there are fewer than ``least``."""
        slam_map = self.map
        around = local_map(slam_map, frame, self.covisibility, self.settings.tracking.local_keyframes)
        if around is None:
            return 0
        self.reference = around.reference
        recently = frame.ordinal - self.recovered_at < 2
        factor = 1.0 if self.camera.mono else FACTOR_WITH_DEPTH
        factor = _FACTOR_AFTER_RECOVERY if recently else factor
        match_local_map(slam_map, frame, around.points, self.camera, factor=factor, gate=self.settings.depth.gate)
        inliers = frame.estimate_pose(slam_map, self.camera, frame.cTw)
        good = frame.inliers()
        slam_map.points.found[frame.points[good]] += 1
        return inliers if inliers >= least else 0

    def _from_motion(self, frame: TrackedFrame) -> bool:
        before, guess = self.last_pose(), self.predicted()
        assert guess is not None
        for width in (1.0, 2.0):
            matches = self._match_last(frame, guess, before, width * WINDOW_MOTION)
            if matches >= MIN_MATCHES_MOTION:
                break
        if matches < MIN_MATCHES_MOTION:
            return False
        inliers = frame.estimate_pose(self.map, self.camera, guess)
        frame.drop_outliers()
        return inliers >= MIN_INLIERS_POSE

    def _match_last(self, frame: TrackedFrame, guess: FloatArray, before: FloatArray, window: float) -> int:
        """Match the previous frame's points to ``frame`` around their projections."""
        assert self.last is not None
        slam_map, camera, last = self.map, self.camera, self.last.frame
        last.points = slam_map.current(last.points)
        rows = last.inliers()
        points = last.points[rows]
        xyz = slam_map.points.xyz[points] @ guess[:3, :3].T + guess[:3, 3]
        front = xyz[:, 2] > 1e-6
        rows, points, xyz = rows[front], points[front], xyz[front]
        uvr = np.full((len(rows), 3), -1.0)
        uvr[:, :2] = camera.pinhole.project(xyz)
        if not camera.mono and self.settings.depth.gate:
            uvr[:, 2] = uvr[:, 0] - camera.bf / xyz[:, 2]
        octave = last.features.octave[rows].astype(np.int64)
        ahead = (before @ inverse(guess))[2, 3]
        # Moving ahead a point appears larger, so on a coarser level.
        low, high = octave - 1, octave + 1
        if not camera.mono and ahead > camera.baseline:
            low, high = octave, np.full_like(octave, len(camera.scales))
        elif not camera.mono and -ahead > camera.baseline:
            low, high = np.zeros_like(octave), octave
        frame.clear()
        found = match_by_projection(
            uvr,
            window * camera.scales[octave],
            (low, high),
            last.features.descriptor[rows],
            frame.features,
            camera.columns,
            limit=DISTANCE_HIGH,
            ratio=RATIO_MOTION,
            angles=last.features.angle[rows],
            slack=camera.right_slack(frame.features.depth),
        )
        return frame.match(found, points)

    def _from_reference(self, frame: TrackedFrame) -> bool:
        """Match the reference keyframe by descriptors and start from the previous pose."""
        slam_map = self.map
        matches = match_keyframe(slam_map, frame, self.reference, limit=DISTANCE_LOW, ratio=RATIO_REFERENCE)
        if matches < MIN_MATCHES_REFERENCE:
            return False
        inliers = frame.estimate_pose(slam_map, self.camera, self.last_pose())
        frame.drop_outliers()
        return inliers >= MIN_INLIERS_POSE

    def _from_wide_search(self, frame: TrackedFrame) -> bool:
        """Match the local map of the previous frame in wide windows around predicted and previous pose."""
        slam_map, gate = self.map, self.settings.depth.gate
        guesses = [guess for guess in (self.predicted(), self.last_pose()) if guess is not None]
        points = slam_map.seen_by(np.append(self.covisibility.of(self.reference)[:10], self.reference))
        for guess in guesses:
            frame.clear()
            frame.cTw = guess
            matches = match_local_map(slam_map, frame, points, self.camera, factor=10.0, gate=gate)
            if matches < MIN_MATCHES_MOTION:
                continue
            inliers = frame.estimate_pose(slam_map, self.camera, guess)
            frame.drop_outliers()
            if inliers >= max(MIN_INLIERS_POSE, MIN_MATCHES_MOTION):
                return True
        return False
