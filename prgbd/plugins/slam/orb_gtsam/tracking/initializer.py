"""The first keyframes of a map; from one frame with depth here, from two frames without in ``two_view_initializer``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.map.keyframe_creation import KeyframeCreator
from prgbd.plugins.slam.orb_gtsam.settings import VGA_AREA
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# ORB-SLAM2 (Tracking::StereoInitialization): keypoints that a first frame must have at 640x480.
_LEAST_KEYPOINTS = 500


def keypoints_to_start(features: int, width: int, height: int) -> int:
    """Return the number of keypoints that a first frame must have.

    Args:
        features: Keypoints that are looked for in a frame; half of them suffice.
        width: Image width, pixels.
        height: Image height; in images smaller than 640x480 the number shrinks with the area.
    """
    area = min(1.0, width * height / VGA_AREA)
    return int(min(_LEAST_KEYPOINTS, 0.5 * features) * area)


@dataclass(frozen=True)
class Placed:
    """An earlier frame that the start gave a pose to."""

    frame_index: int
    ordinal: int
    timestamp: float
    reference: int
    cTw: FloatArray
    inliers: int


@dataclass(frozen=True)
class Started:
    """A new map.

    Attributes:
        reference: Keyframe made of the present frame.
        keyframes: All keyframes of the new map, the earliest first.
        cTw: (4, 4) its pose.
        points: (N,) int64 point of every keypoint.
        earlier: Earlier frames that got a pose as well.
    """

    reference: int
    keyframes: tuple[int, ...]
    cTw: FloatArray
    points: IntArray
    earlier: list[Placed] = field(default_factory=list)


class Initializer(ABC):
    """Takes frames until a map can be started.

    Attributes:
        starts: What every map was started from, for the statistics.
    """

    def __init__(self, creator: KeyframeCreator, least_keypoints: int) -> None:
        self.creator = creator
        self.least_keypoints = least_keypoints
        self.origin: FloatArray = np.eye(4)
        self.starts: list[dict[str, Any]] = []

    def begin_at(self, cTw: FloatArray) -> None:
        """Start the next map at this pose."""
        self.origin = cTw

    @abstractmethod
    def add(self, frame: TrackedFrame) -> Started | None:
        """Take a frame; return the new map once there is one."""


class DepthInitializer(Initializer):
    """Starts from one frame with enough keypoints and depth (Tracking::StereoInitialization)."""

    # Fewer points could not be tracked from the next frame.
    _LEAST_POINTS = 50

    def add(self, frame: TrackedFrame) -> Started | None:
        """See ``Initializer.add``."""
        features = frame.features
        if len(features) <= self.least_keypoints or np.count_nonzero(features.depth > 0) < self._LEAST_POINTS:
            return None
        k = self.creator.add(frame.index, frame.timestamp, self.origin, features, frame.points)
        points = self.creator.lift_all(k)
        self.starts.append({"frames": [frame.index], "points": int(np.count_nonzero(points >= 0))})
        return Started(k, (k,), self.origin, points)
