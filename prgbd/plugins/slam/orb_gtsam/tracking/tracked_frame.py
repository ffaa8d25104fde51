"""The frame that is being tracked."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.optimisation.pose_optimisation import optimise_pose

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass
class TrackedFrame:
    """One frame on its way through tracking.

    Attributes:
        index: Position in the sequence.
        timestamp: Seconds.
        ordinal: How many frames were given before it, whatever their index.
        features: Its keypoints.
        cTw: (4, 4) world to camera, as far as known.
        points: (N,) int64 map point of every keypoint, -1 for none.
        outlier: (N,) bool matches that disagree with the pose.
    """

    index: int
    timestamp: float
    ordinal: int
    features: Features
    cTw: FloatArray = field(default_factory=lambda: np.eye(4))
    points: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    outlier: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))

    def __post_init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all matches."""
        self.points = np.full(len(self.features), -1, np.int64)
        self.outlier = np.zeros(len(self.features), np.bool_)

    def matched(self) -> IntArray:
        """Return the keypoints that have a point."""
        return np.flatnonzero(self.points >= 0)

    def inliers(self) -> IntArray:
        """Return the keypoints whose point agrees with the pose."""
        return np.flatnonzero((self.points >= 0) & ~self.outlier)

    def match(self, keypoints: IntArray, points: IntArray) -> int:
        """Give ``points`` to ``keypoints`` (-1: no match) and return how many there were."""
        good = keypoints >= 0
        self.points[keypoints[good]] = points[good]
        self.outlier[keypoints[good]] = False
        return int(np.count_nonzero(good))

    def estimate_pose(self, slam_map: Map, camera: CameraModel, cTw0: FloatArray) -> int:
        """Optimise the pose from ``cTw0`` on all matches, mark outliers and return the number of inliers."""
        rows = self.matched()
        if len(rows) < 4:
            self.cTw = cTw0
            return 0
        cTw, inlier = optimise_pose(
            np.ascontiguousarray(cTw0),
            slam_map.points.xyz[self.points[rows]],
            camera.measured(self.features, rows),
            camera.weights(self.features.octave[rows], self.features.depth[rows]),
            camera.intrinsics,
            depth_fallback=camera.noise.fallback,
        )
        self.cTw = cTw
        self.outlier[rows] = ~inlier
        return int(np.count_nonzero(inlier))

    def drop_outliers(self) -> None:
        """Forget the matches that disagree with the pose."""
        self.points[self.outlier] = -1
        self.outlier[:] = False
