"""The interface of SLAM systems: ``GeometricSLAM``."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import ConfigError
from prgbd.core.types import Frame, PinholeCamera, SlamResult

log = logging.getLogger(__name__)

MODES = ("mono", "rgbd", "pseudo_rgbd", "stereo")

# Virtual baseline and largest depth on KITTI, whose ratio the adaptive baseline keeps (Tiwari et al., ECCV 2020).
KITTI_BASELINE = 0.54
KITTI_DEPTH_MAX = 80.0


def adaptive_baseline(depth_max: float) -> float:
    """Return the virtual baseline that goes with the largest predicted depth (Tiwari et al., ECCV 2020)."""
    return KITTI_BASELINE / KITTI_DEPTH_MAX * depth_max


class TrackingState(StrEnum):
    """What a SLAM system says of one frame."""

    NOT_INITIALIZED = "not_initialized"
    OK = "ok"
    LOST = "lost"
    COLLECTED = "collected"  # an offline system has stored the frame and decides in ``finish``
    INTERPOLATED = "interpolated"  # its pose was put between those of its neighbours; the image says nothing of it


Listener = Callable[[str, int, int], None]
"""Called with what a system is doing, how many units of it are done, and how many there are."""


@dataclass(frozen=True)
class TrackingResult:
    """The answer to one frame.

    Attributes:
        state: What became of the frame.
        wTc: (4, 4) float64 camera-to-world as known now, or None without a pose.
        inliers: Number of map points that agree with the pose.
        is_keyframe: Whether the frame was made a keyframe.
        info: What the system likes to say of itself, as in Gymnasium's ``step``. The progress line shows the whole
            numbers ``keyframes``, ``points`` and ``maps``.
    """

    state: TrackingState
    wTc: NDArray[np.float64] | None = None
    inliers: int = 0
    is_keyframe: bool = False
    info: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SlamView:
    """What a system knows at the moment, for people who watch.

    Attributes:
        keyframes: (K, 4, 4) float64 camera-to-world.
        points: (P, 3) float64 map points in the world.
        rgb: (P, 3) uint8 their colours.
        keypoints: (N, 2) float32 pixels of the last frame's keypoints that agree with the map.
    """

    keyframes: NDArray[np.float64]
    points: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    keypoints: NDArray[np.float32]


class GeometricSLAM(ABC):
    """A SLAM system: ``reset``, then ``track`` once per frame in order, then ``finish``; ``close`` frees everything.

    Pseudo RGB-D gives frames whose depth comes from a ``DepthEstimator``, and the adaptive virtual ``baseline`` of the
    paper. A system that treats such depth in its own way lists the mode ``pseudo_rgbd``; others get it as ``rgbd``.
    Lost tracking is a result, not an exception. An offline system collects frames in ``track`` and works in ``finish``.
    A system is a context manager that closes itself.

    Attributes:
        modes: The modes that the system supports, out of ``mono``, ``rgbd``, ``pseudo_rgbd``, ``stereo``.
    """

    modes: ClassVar[frozenset[str]] = frozenset()

    def expect_depth(self, kind: DepthKind) -> None:
        """Learn, before ``reset``, what the pseudo depth of the frames is; optional.

        A system that does not override it takes inverse depth that lacks a shift as it is, and the log says so.
        """
        if kind == DepthKind.AFFINE_DISPARITY:
            log.warning(
                "%s takes depth as it is, but this network's inverse depth is only known up to scale and shift; "
                "slam=orb_gtsam finds both.",
                type(self).__name__,
            )

    @abstractmethod
    def reset(
        self, camera: PinholeCamera, mode: str, *, baseline: float | None = None, fps: float = 30.0, seed: int = 0
    ) -> None:
        """Forget everything and get ready for a sequence.

        Args:
            camera: Camera of the frames; without distortion, unless the system says that it undistorts by itself.
            mode: One of ``modes``.
            baseline: Metres between the (virtual) stereo pair; None for ``mono``, and for ``pseudo_rgbd`` where the
                system is to adapt it as frames come; else needed.
            fps: Frame rate, for the keyframe decision.
            seed: Seed of everything random.

        Raises:
            ConfigError: If the mode is not supported or the baseline is missing or not positive.
        """

    @abstractmethod
    def track(self, frame: Frame) -> TrackingResult:
        """Take in the next frame.

        Raises:
            ContractError: If the frame does not fit the camera or lacks the depth or right image that the mode needs.
        """

    @abstractmethod
    def finish(self) -> SlamResult:
        """End the sequence and return all that was found; a map-wide optimisation may run here."""

    def listen(self, listener: Listener | None) -> None:  # noqa: B027 - optional to override
        """Tell ``listener`` of work that takes more than a moment, in ``finish`` above all; optional."""

    def view(self) -> SlamView | None:
        """Return copies of what is known now, between two calls of ``track``; None if the system does not tell."""
        return None

    def save_map(self, path: Path | str) -> None:
        """Write the map to a file, at any time between ``reset`` and ``close``; optional.

        Raises:
            ConfigError: If the system has no such files.
        """
        raise ConfigError(f"{type(self).__name__} cannot save its map; leave slam.save_map out.")

    def load_map(self, path: Path | str) -> None:
        """Take the map of an earlier recording of the same place, between ``reset`` and the first frame; optional.

        Frames are then looked for in that map, and poses are in its coordinates. The result's keyframes and
        observations are those of the present recording, its points those of the whole map.

        Raises:
            ConfigError: If the system has no such files, or the map does not fit the recording.
            DataError: If the file cannot be read.
        """
        raise ConfigError(f"{type(self).__name__} cannot load a map; leave slam.load_map out.")

    def close(self) -> None:  # noqa: B027 - optional to override
        """Free threads, files and memory; safe to call twice."""

    def __enter__(self) -> GeometricSLAM:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None
    ) -> None:
        self.close()
