"""The motion model: where a camera gets to that goes on as it did."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, inverse, log_se3

FloatArray = NDArray[np.float64]

# Frames whose mean motion is taken: enough to smooth a single step, few enough to follow a bend.
_FRAMES = 5


class MotionModel:
    """Remembers the last poses of a camera and carries their mean motion on."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, FloatArray]] = deque(maxlen=_FRAMES + 1)

    def clear(self) -> None:
        """Forget everything, for example because the next pose is another map's."""
        self._poses.clear()

    def add(self, ordinal: int, cTw: FloatArray) -> None:
        """Remember the pose of frame number ``ordinal``."""
        self._poses.append((ordinal, cTw.copy()))

    def after(self, frames: int) -> FloatArray:
        """Return the motion over ``frames`` frames, (4, 4) from the last camera to the expected one.

        It is the identity where fewer than two poses are known.
        """
        if len(self._poses) < 2 or frames <= 0:
            return np.eye(4)
        (first, before), (last, now) = self._poses[0], self._poses[-1]
        per_frame = log_se3(now @ inverse(before)) / (last - first)
        return exp_se3(per_frame * frames)
