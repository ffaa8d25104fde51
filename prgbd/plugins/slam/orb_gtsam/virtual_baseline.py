"""The virtual baseline of pseudo RGB-D: adapted to the network's depth as frames come, and what changes with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.core.slam import adaptive_baseline
from prgbd.plugins.slam.orb_gtsam.mapping import Map
from prgbd.plugins.slam.orb_gtsam.rig import Rig
from prgbd.plugins.slam.orb_gtsam.settings import Settings

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


def set_baseline(rig: Rig, settings: Settings, baseline: float) -> None:
    """Give the rig a baseline in metres, and the depths that are counted in baselines."""
    rig.baseline = baseline
    rig.close_depth = baseline * settings.close_depth
    rig.trusted_depth = baseline * settings.depth_trust if settings.depth_trust > 0 else np.inf


def follow_baseline(world: Map, rig: Rig) -> None:
    """Move the right columns of all keyframes to where the rig's baseline puts them; the caller holds the lock."""
    kf = world.keyframes
    measured = (kf.u_right[: kf.count] >= 0) & (kf.depth[: kf.count] > 0)
    right = kf.uv[: kf.count, :, 0] - np.float32(rig.bf) / np.where(measured, kf.depth[: kf.count], 1)
    kf.u_right[: kf.count][measured] = right[measured]
