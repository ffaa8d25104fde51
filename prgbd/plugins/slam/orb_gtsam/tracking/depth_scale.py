"""The scale of a network's depth against the map, followed from frame to frame."""

from __future__ import annotations

import numpy as np

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame

# Fewer points do not tell the scale of a frame's depth.
_LEAST_RATIOS = 20
_IN_FRONT = 1e-6


class DepthScaleFollower:
    """Divides the depth of every frame by the scale that it has against the map.

    A network's scale wanders along a drive, and it wanders slowly: the last frame's is nearly this one's. Corrected by
    it, depth starts maps, places new points and gates matches, but no scale comes in by that door: over short
    distances geometry knows it much better. What the network knows over long ones comes in at the end of the recording
    (``scale_drift.correct_scale``).

    Attributes:
        log_scale: Logarithm of measured depth over map depth.

    Args:
        slam_map: The map.
        camera: The camera.
    """

    def __init__(self, slam_map: Map, camera: CameraModel) -> None:
        self.map, self.camera = slam_map, camera
        self.log_scale = 0.0

    def correct(self, features: Features) -> None:
        """Divide the depth of a frame's keypoints by the scale that was last known, in place."""
        divide_depth(features, self.log_scale, self.camera.bf)

    def observe(self, frame: TrackedFrame) -> None:
        """Measure the scale at a tracked frame, whose depth ``correct`` has divided, and divide it by what is left."""
        features, rows = frame.features, frame.inliers()
        rows = rows[features.depth[rows] > 0]
        z = self.map.points.xyz[frame.points[rows]] @ frame.cTw[2, :3] + frame.cTw[2, 3]
        rows, z = rows[z > _IN_FRONT], z[z > _IN_FRONT]
        if len(rows) < _LEAST_RATIOS:
            return
        left = float(np.median(np.log(features.depth[rows] / z)))
        self.log_scale += left
        divide_depth(features, left, self.camera.bf)

    def note(self, keyframe: int) -> None:
        """Keep with a new keyframe by what its depth was divided."""
        self.map.keyframes.log_depth_scale[keyframe] = self.log_scale


def divide_depth(features: Features, log_scale: float, bf: float) -> None:
    """Divide the depth of keypoints by ``exp(log_scale)`` in place; their right columns follow.

    Args:
        features: The keypoints.
        log_scale: Logarithm of the divisor.
        bf: Baseline times focal length, pixels times the unit of the depth.
    """
    if log_scale == 0.0:
        return
    features.depth[:] *= np.float32(np.exp(-log_scale))
    stereo = (features.u_right >= 0) & (features.depth > 0)
    features.u_right[stereo] = features.uv[stereo, 0] - np.float32(bf) / features.depth[stereo]
