"""Tracking: the pose of every frame from the previous frame, the reference keyframe and the local map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.frames import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.lie import inverse
from prgbd.plugins.slam.orb_gtsam.local_map import Neighbourhoods, local_map, match_keyframe, match_local_map
from prgbd.plugins.slam.orb_gtsam.mapping import Map
from prgbd.plugins.slam.orb_gtsam.matching import match_by_projection
from prgbd.plugins.slam.orb_gtsam.rig import Rig
from prgbd.plugins.slam.orb_gtsam.settings import Settings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# ORB-SLAM2 (Tracking::SearchLocalPoints): wider windows just after relocalisation.
_FACTOR_AFTER_RECOVERY = 5.0


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
        rig: The camera.
        world: The map.
        near: Covisible keyframes.
    """

    def __init__(self, settings: Settings, rig: Rig, world: Map, near: Neighbourhoods) -> None:
        self.settings, self.rig, self.world, self.near = settings, rig, world, near
        self.last: LastFrame | None = None
        self.velocity: FloatArray | None = None
        self.reference = -1
        self.recovered_at = -(1 << 30)

    def last_pose(self) -> FloatArray:
        """Return the pose of the last tracked frame, corrected with its reference keyframe."""
        assert self.last is not None
        return self._in_present_units(self.last.cTref) @ self.world.pose_of(self.last.reference)

    def predicted(self) -> FloatArray | None:
        """Return the pose that the last motion leads to, or None if it is not known."""
        return None if self.velocity is None else self._in_present_units(self.velocity) @ self.last_pose()

    def _in_present_units(self, motion: FloatArray) -> FloatArray:
        """Return a motion of the time of the last frame in the units that the map has there now."""
        assert self.last is not None
        out: FloatArray = motion.copy()
        out[:3, 3] *= self.world.keyframes.scale[self.last.reference] / self.last.scale
        return out

    def track(self, frame: TrackedFrame) -> int:
        """Find the pose of a frame; return its inliers, 0 if it is lost."""
        self.reference = self.world.successor(self.reference)
        found = self.velocity is not None and self._from_motion(frame)
        found = found or self._from_reference(frame)
        found = found or self._from_wide_search(frame)
        return self.from_local_map(frame, self.settings.min_inliers_map) if found else 0

    def remember(self, frame: TrackedFrame) -> None:
        """Take a tracked frame as the previous one of the next."""
        if self.last is not None:
            self.velocity = frame.cTw @ inverse(self.last_pose())
        self.refer(frame)

    def refer(self, frame: TrackedFrame) -> None:
        """Keep ``frame`` relative to the reference keyframe, as the previous frame."""
        self.reference = self.world.successor(self.reference)
        cTref = frame.cTw @ inverse(self.world.keyframes.cTw[self.reference])
        self.last = LastFrame(frame, self.reference, cTref, float(self.world.keyframes.scale[self.reference]))

    def from_local_map(self, frame: TrackedFrame, least: int) -> int:
        """Match the local map, optimise and judge; return the inliers, 0 if there are fewer than ``least``."""
        world, settings = self.world, self.settings
        around = local_map(world, frame, self.near, settings)
        if around is None:
            return 0
        self.reference = around.reference
        recently = frame.ordinal - self.recovered_at < 2
        factor = 1.0 if self.rig.mono else settings.window_local_map
        match_local_map(
            world, frame, around.points, self.rig, settings, factor=_FACTOR_AFTER_RECOVERY if recently else factor
        )
        inliers = frame.estimate_pose(world, self.rig, frame.cTw)
        good = frame.inliers()
        world.points.found[frame.points[good]] += 1
        return inliers if inliers >= least else 0

    def _from_motion(self, frame: TrackedFrame) -> bool:
        before, guess = self.last_pose(), self.predicted()
        assert guess is not None
        for width in (1.0, 2.0):
            matches = self._match_last(frame, guess, before, width * self.settings.window_motion)
            if matches >= self.settings.min_matches_motion:
                break
        if matches < self.settings.min_matches_motion:
            return False
        inliers = frame.estimate_pose(self.world, self.rig, guess)
        frame.drop_outliers()
        return inliers >= self.settings.min_inliers_pose

    def _match_last(self, frame: TrackedFrame, guess: FloatArray, before: FloatArray, window: float) -> int:
        """Match the previous frame's points to ``frame`` around their projections."""
        assert self.last is not None
        world, rig, last = self.world, self.rig, self.last.frame
        last.points = world.current(last.points)
        rows = last.inliers()
        points = last.points[rows]
        xyz = world.points.xyz[points] @ guess[:3, :3].T + guess[:3, 3]
        front = xyz[:, 2] > 1e-6
        rows, points, xyz = rows[front], points[front], xyz[front]
        uvr = np.full((len(rows), 3), -1.0)
        uvr[:, :2] = rig.camera.project(xyz)
        if not rig.mono and self.settings.stereo_gate:
            uvr[:, 2] = uvr[:, 0] - rig.bf / xyz[:, 2]
        octave = last.features.octave[rows].astype(np.int64)
        ahead = (before @ inverse(guess))[2, 3]
        # Moving ahead a point appears larger, so on a coarser level.
        low, high = octave - 1, octave + 1
        if not rig.mono and ahead > rig.baseline:
            low, high = octave, np.full_like(octave, len(rig.scales))
        elif not rig.mono and -ahead > rig.baseline:
            low, high = np.zeros_like(octave), octave
        frame.clear()
        found = match_by_projection(
            uvr,
            window * rig.scales[octave],
            (low, high),
            last.features.descriptor[rows],
            frame.features,
            rig.columns,
            limit=self.settings.distance_high,
            ratio=self.settings.ratio_motion,
            angles=last.features.angle[rows],
            slack=rig.right_slack(frame.features.depth),
        )
        return frame.match(found, points)

    def _from_reference(self, frame: TrackedFrame) -> bool:
        """Match the reference keyframe by descriptors and start from the previous pose."""
        world, settings = self.world, self.settings
        matches = match_keyframe(
            world, frame, self.reference, limit=settings.distance_low, ratio=settings.ratio_reference
        )
        if matches < settings.min_matches_reference:
            return False
        inliers = frame.estimate_pose(world, self.rig, self.last_pose())
        frame.drop_outliers()
        return inliers >= settings.min_inliers_pose

    def _from_wide_search(self, frame: TrackedFrame) -> bool:
        """Match the local map of the previous frame in wide windows around predicted and previous pose."""
        world, settings = self.world, self.settings
        guesses = [guess for guess in (self.predicted(), self.last_pose()) if guess is not None]
        points = world.seen_by(np.append(self.near.of(self.reference)[:10], self.reference))
        for guess in guesses:
            frame.clear()
            frame.cTw = guess
            matches = match_local_map(world, frame, points, self.rig, settings, factor=10.0)
            if matches < settings.min_matches_motion:
                continue
            inliers = frame.estimate_pose(world, self.rig, guess)
            frame.drop_outliers()
            if inliers >= max(settings.min_inliers_pose, settings.min_matches_motion):
                return True
        return False
