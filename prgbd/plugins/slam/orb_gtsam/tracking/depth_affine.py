"""The scale and the shift of a network's inverse depth against the map, found anew in every frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.geometry.affine_fit import Affine, fit_affine
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.tracking.depth_scale import DepthScaleFollower
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame

FloatArray = NDArray[np.float64]

# Fewer points do not tell scale and shift of a frame's inverse depth.
_LEAST_POINTS = 20
_IN_FRONT = 1e-6
# Error of inverse depth: a share of itself, and a share of the median that even what is far errs by.
_RELATIVE, _ABSOLUTE = 0.15, 0.05
# How much scale (as a share) and shift (in medians of the map's inverse depth) change from frame to frame: networks of
# this kind hold neither, so the last frame only steadies a frame that shows a plane or little.
_SCALE_STEP, _SHIFT_STEP = 0.3, 0.3
# Inverse depth below this share of the median is too far to be measured.
_FAR = 0.05
# Inverse depth so near to the smallest of an image says only that it is far, as of the sky.
_SATURATED = 1.00001


class AffineDepthFollower(DepthScaleFollower):
    """Takes depth into a frame once the frame's place in the map tells scale and shift of its inverse depth.

    Until then the frame has no depth: maps start from two views and poses come from pixels alone. Its depth places
    new points, tells what is close, and through its scale it speaks of the map's drift at the end of the recording.
    """

    def __init__(self, slam_map: Map, camera: CameraModel) -> None:
        super().__init__(slam_map, camera)
        self._disparity = np.zeros(0)
        self._last: Affine | None = None
        self._known = False
        # Logarithms of the scales of the frames since the last keyframe.
        self._scales: list[float] = []

    def correct(self, features: Features) -> None:
        """Take the depth of a frame's keypoints away, and keep it for ``observe``."""
        measured = (features.depth > 0) & (features.u_right != -1)
        self._disparity = np.where(measured, 1.0 / np.where(measured, features.depth, 1.0), 0.0)
        if measured.any():
            farthest = float(self._disparity[measured].min())
            self._disparity[self._disparity <= _SATURATED * farthest] = 0.0
        features.depth[:], features.u_right[:] = 0.0, -1.0
        self._known = False

    def observe(self, frame: TrackedFrame) -> None:
        """Fit scale and shift at a tracked frame whose depth ``correct`` has taken away, and give it depth by them."""
        rows = frame.inliers()
        rows = rows[self._disparity[rows] > 0]
        z = self.map.points.xyz[frame.points[rows]] @ frame.cTw[2, :3] + frame.cTw[2, 3]
        rows, z = rows[z > _IN_FRONT], z[z > _IN_FRONT]
        if len(rows) < _LEAST_POINTS:
            return
        inverse, middle = 1.0 / z, float(np.median(1.0 / z))
        sigma = np.hypot(_RELATIVE * inverse, _ABSOLUTE * middle)
        last = self._last
        wander = None if last is None else Affine(_SCALE_STEP * last.scale, _SHIFT_STEP * middle)
        found = fit_affine(self._disparity[rows], inverse, sigma, last, wander)
        if found.scale <= 0:
            return
        self._last, self._known = found, True
        self.log_scale = float(np.log(found.scale))
        self._scales.append(self.log_scale)
        self._give_depth(frame.features, found(self._disparity), _FAR * middle)

    def note(self, keyframe: int) -> None:
        """Keep with a new keyframe by what its depth, free of the shift, was divided: the mean of all frames before it.

        What an image's scale says of the map's drift is little, as it is chosen anew, so that every frame counts.
        """
        if self._known:
            self.map.keyframes.log_depth_scale[keyframe] = np.mean(self._scales)
        self._scales.clear()

    def _give_depth(self, features: Features, inverse: FloatArray, least: float) -> None:
        """Write depth and right columns where inverse depth (N,) was measured and is not below ``least``."""
        good = (self._disparity > 0) & (inverse > least)
        features.depth[good] = (1.0 / inverse[good]).astype(np.float32)
        right = features.uv[good, 0] - np.float32(self.camera.bf) / features.depth[good]
        features.u_right[good] = np.where(features.depth[good] <= self.camera.trusted_depth, right, np.float32(-1.0))
