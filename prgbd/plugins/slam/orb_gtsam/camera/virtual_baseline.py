"""The virtual baseline of pseudo RGB-D, adapted to the network's depth as frames come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.core.slam import KITTI_BASELINE, adaptive_baseline
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.settings import DepthOptions

# The baseline of depth that has no unit, per median depth of a new map: on KITTI the median of keypoints is about 13 m.
MEDIAN_BASELINE = KITTI_BASELINE / 13.0
# A largest depth that grows by less leaves the baseline as it is.
_GROWTH = 1.05


class RunningBaseline:
    """The adaptive baseline of the frames so far, for use without knowing the whole sequence."""

    def __init__(self) -> None:
        self.baseline = 0.0

    def see(self, depth: NDArray[np.float32]) -> bool:
        """Take in the depth (H, W) of a frame; return whether the baseline grew."""
        known = depth[np.isfinite(depth) & (depth > 0)]
        found = adaptive_baseline(float(known.max())) if known.size else 0.0
        if found <= _GROWTH * self.baseline:
            return False
        self.baseline = found
        return True


def set_baseline(camera: CameraModel, options: DepthOptions, baseline: float) -> None:
    """Give the camera a baseline in metres, and the depths that are counted in baselines."""
    camera.baseline = baseline
    camera.close_depth = baseline * options.close
    camera.trusted_depth = baseline * options.trust if options.trust > 0 else np.inf
