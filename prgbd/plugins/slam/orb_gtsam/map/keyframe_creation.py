"""How a frame becomes a keyframe of the map, and its measured depth points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

# ORB-SLAM2 (Tracking::CreateNewKeyFrame): at least this many of the closest points are created with a keyframe.
CLOSEST_LIFTED = 100
# Fewer points do not tell the scale of a keyframe's depth.
_LEAST_RATIOS = 20


class KeyframeCreator:
    """Adds keyframes with the points that their frames saw, and new points at their measured depth.

    Args:
        camera: The camera.
        slam_map: The map.
        covisibility: Covisible keyframes, cleared with each new one.
    """

    def __init__(self, camera: CameraModel, slam_map: Map, covisibility: CovisibilityGraph) -> None:
        self.camera, self.map, self.covisibility = camera, slam_map, covisibility

    def add(self, frame_index: int, timestamp: float, cTw: FloatArray, features: Features, points: IntArray) -> int:
        """Add a keyframe that observes ``points`` ((N,) int64, -1 for none) and return its number."""
        slam_map = self.map
        k = slam_map.add_keyframe(frame_index, timestamp, cTw, features, points)
        if not self.camera.mono:
            rows = self._rows_to_lift(k)
            new = slam_map.add_points(k, rows, self.camera.lift(features, rows, inverse(cTw), self._depth_ratio(k)))
            slam_map.probation.append((k, new))
        seen = slam_map.points_of(k)
        slam_map.refresh(seen[seen >= 0])
        self.covisibility.clear()
        return k

    def lift_all(self, k: int) -> IntArray:
        """Give every keypoint of a first keyframe that has depth its point (Tracking::StereoInitialization)."""
        slam_map = self.map
        features = slam_map.features(k)
        rows = np.flatnonzero((features.depth > 0) & (slam_map.points_of(k) < 0))
        new = slam_map.add_points(k, rows, self.camera.lift(features, rows, inverse(slam_map.keyframes.cTw[k])))
        slam_map.refresh(new)
        return slam_map.points_of(k).copy()

    def _rows_to_lift(self, k: int) -> IntArray:
        """Keypoints to lift: all that are close, at least the closest ones, of those without a point."""
        depth = self.map.features(k).depth
        order = np.argsort(depth, kind="stable")
        order = order[depth[order] > 0]
        wanted = (depth[order] <= self.camera.close_depth) | (np.arange(len(order)) < CLOSEST_LIFTED)
        order = order[wanted]
        return order[self.map.points_of(k)[order] < 0]

    def _depth_ratio(self, k: int) -> float:
        """Median of measured depth over map depth of the points that keyframe ``k`` sees; 1 for a sensor.

        A network's scale wanders: new points take the scale of the map around them, and the weak weight of all depths
        together holds the scale of the map.
        """
        slam_map = self.map
        rows = np.flatnonzero((slam_map.points_of(k) >= 0) & (slam_map.features(k).depth > 0))
        if self.camera.noise.is_zero or len(rows) < _LEAST_RATIOS:
            return 1.0
        cTw = slam_map.keyframes.cTw[k]
        z = slam_map.points.xyz[slam_map.points_of(k)[rows]] @ cTw[2, :3] + cTw[2, 3]
        front = z > 1e-6
        return float(np.median(slam_map.features(k).depth[rows[front]] / z[front])) if front.any() else 1.0
