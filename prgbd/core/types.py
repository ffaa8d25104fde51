"""The data types in which the parts of prgbd meet.

Conventions (one place for all of prgbd): metres, seconds, pixels, radians. Camera axes are x right,
y down, z forward and depth is z. Poses are 4x4 float64 camera-to-world matrices called ``wTc``.
Pixel (u, v) has integers at pixel *centres*. Images are RGB. Large sets are columns of arrays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError

if TYPE_CHECKING:
    import torch

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.integer[Any]]


def resize_pixels(uv: Any, scale: Any) -> Any:
    """Return where pixels lie after their image was resized.

    With integers at pixel centres an image spans [-0.5, width - 0.5], so pixels scale about -0.5. This is the only
    place in prgbd that knows the rule; ``PinholeCamera.resized`` applies it to cameras.

    Args:
        uv: Columns, rows or pixels (..., 2); a number, an array or a tensor.
        scale: New over old size, of what ``uv`` holds.

    Returns:
        The same kind as ``uv``.
    """
    return (uv + 0.5) * scale - 0.5


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera, optionally with OpenCV's radial-tangential distortion.

    Args:
        width: Image width in pixels.
        height: Image height in pixels.
        fx: Horizontal focal length in pixels.
        fy: Vertical focal length in pixels.
        cx: Principal point column in pixels, integers at pixel centres.
        cy: Principal point row in pixels, integers at pixel centres.
        distortion: OpenCV coefficients ``(k1, k2, p1, p2[, k3])``; empty for none.

    Raises:
        ConfigError: If a size or focal length is not positive, or a value is not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        values = (self.width, self.height, self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.all(np.isfinite(values)):
            raise ConfigError(f"The camera has a value that is not finite: {values}; check the calibration.")
        if min(self.width, self.height) <= 0 or min(self.fx, self.fy) <= 0:
            raise ConfigError(
                f"The camera needs positive sizes and focal lengths, got {self.width}x{self.height} pixels with "
                f"fx={self.fx:g}, fy={self.fy:g}; check the calibration."
            )

    @property
    def K(self) -> NDArray[np.float64]:
        """Intrinsic matrix, (3, 3) float64, in pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> PinholeCamera:
        """Return the camera of the image resized to ``width`` x ``height`` pixels, by the rule of ``resize_pixels``."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=resize_pixels(self.cx, sx),
            cy=resize_pixels(self.cy, sy),
        )

    def flipped(self) -> PinholeCamera:
        """Return the camera of the horizontally mirrored image."""
        return replace(self, cx=self.width - 1 - self.cx)

    def undistorted(self) -> PinholeCamera:
        """Return the same camera without distortion."""
        return replace(self, distortion=())

    @classmethod
    def from_fov(cls, width: int, height: int, fov_degrees: float) -> PinholeCamera:
        """Make a camera with square pixels from its horizontal field of view in degrees.

        Raises:
            ConfigError: If the field of view is not between 0 and 180 degrees.
        """
        if not 0.0 < fov_degrees < 180.0:
            raise ConfigError(f"The field of view must lie between 0 and 180 degrees, got {fov_degrees:g}.")
        f = 0.5 * width / np.tan(np.radians(fov_degrees) / 2)
        return cls(width, height, float(f), float(f), (width - 1) / 2, (height - 1) / 2)

    def project(self, points: FloatArray) -> NDArray[np.float64]:
        """Project points in camera coordinates, (N, 3) metres, to pixels, (N, 2), ignoring distortion."""
        p = np.asarray(points, np.float64)
        return np.stack([self.fx * p[:, 0] / p[:, 2] + self.cx, self.fy * p[:, 1] / p[:, 2] + self.cy], axis=1)

    def backproject(self, pixels: FloatArray, depth: FloatArray) -> NDArray[np.float64]:
        """Lift pixels, (N, 2), with depth, (N,) metres, to camera coordinates, (N, 3), ignoring distortion."""
        uv = np.asarray(pixels, np.float64)
        z = np.asarray(depth, np.float64)
        return np.stack([(uv[:, 0] - self.cx) / self.fx * z, (uv[:, 1] - self.cy) / self.fy * z, z], axis=1)

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers for JSON."""
        return {
            "width": self.width,
            "height": self.height,
            "fx": self.fx,
            "fy": self.fy,
            "cx": self.cx,
            "cy": self.cy,
            "distortion": list(self.distortion),
        }


@dataclass(frozen=True)
class Frame:
    """One image of a sequence, with what is known about it.

    Attributes:
        index: Position in the sequence.
        timestamp: Seconds.
        image: (H, W, 3) uint8 RGB.
        depth: (H, W) float32 in metres (or up to scale, for pseudo depth); 0 where unknown. None without a sensor.
        right: (H, W, 3) uint8 RGB, the rectified right image of a stereo pair, or None.
        depth_sigma: (H, W) float32, positive: the standard deviation of the logarithm of ``depth``, without the error
            of scale that all of the frame shares. None where nobody knows it.
    """

    index: int
    timestamp: float
    image: NDArray[np.uint8]
    depth: NDArray[np.float32] | None = None
    right: NDArray[np.uint8] | None = None
    depth_sigma: NDArray[np.float32] | None = None

    def with_depth(self, depth: NDArray[np.float32] | None, sigma: NDArray[np.float32] | None = None) -> Frame:
        """Return the frame with another depth map and its standard deviation of log depth."""
        return replace(self, depth=depth, depth_sigma=sigma)


@dataclass(frozen=True)
class Trajectory:
    """Camera poses over time; frames without a pose are absent.

    Attributes:
        frame_index: (N,) int64, ascending position in the sequence.
        timestamp: (N,) float64 seconds.
        wTc: (N, 4, 4) float64 camera-to-world.
    """

    frame_index: NDArray[np.int64]
    timestamp: NDArray[np.float64]
    wTc: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.frame_index)

    @classmethod
    def empty(cls) -> Trajectory:
        """Return a trajectory without poses."""
        return cls(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 4, 4)))

    @property
    def positions(self) -> NDArray[np.float64]:
        """Camera centres in the world, (N, 3) metres."""
        return self.wTc[:, :3, 3]


@dataclass(frozen=True)
class Keyframes:
    """The keyframes of a map as columns; the row number is the keyframe's id within the result.

    Attributes:
        frame_index: (K,) int64, ascending.
        timestamp: (K,) float64 seconds.
        wTc: (K, 4, 4) float64.
        map_id: (K,) int32, which of several unconnected maps the keyframe belongs to.
    """

    frame_index: NDArray[np.int64]
    timestamp: NDArray[np.float64]
    wTc: NDArray[np.float64]
    map_id: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.frame_index)


@dataclass(frozen=True)
class MapPoints:
    """The points of a map as columns; the row number is the point's id within the result.

    Attributes:
        xyz: (P, 3) float64 world coordinates in metres (up to scale for mono and pseudo RGB-D).
        rgb: (P, 3) uint8 colour for export.
    """

    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True)
class Observations:
    """Which keyframe sees which point where, as columns.

    Attributes:
        keyframe: (M,) int64 row of ``Keyframes``.
        point: (M,) int64 row of ``MapPoints``.
        uv: (M, 2) float32 *undistorted* pixel of the keypoint in the frame's full-size image.
        depth: (M,) float32 measured depth at the keypoint in metres, 0 where there is none.
    """

    keyframe: NDArray[np.int64]
    point: NDArray[np.int64]
    uv: NDArray[np.float32]
    depth: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.keyframe)


@dataclass(frozen=True)
class SlamResult:
    """All that SLAM found out about a sequence.

    Attributes:
        camera: The camera that the observations and poses refer to. They are undistorted; where the camera has
            distortion, SLAM found it in the recording's images, which have to be undistorted to belong to them.
        mode: ``mono``, ``rgbd`` or ``stereo``.
        frames: Number of frames that were given to ``track``.
        trajectory: Final poses of all tracked frames (corrected with their keyframes).
        keyframes: Keyframes that survived culling.
        points: Map points that survived culling.
        observations: Keyframe-to-point observations.
        states: (frames,) strings, the ``TrackingState`` value of every frame.
        inliers: (frames,) int32 inlier matches of every frame.
        online: Poses as they were known when each frame was tracked, or None.
        stats: Diagnostics for ``slam.json`` (stage times in ms, counts, loop closures, ...); plain numbers and lists.
    """

    camera: PinholeCamera
    mode: str
    frames: int
    trajectory: Trajectory
    keyframes: Keyframes
    points: MapPoints
    observations: Observations
    states: list[str]
    inliers: NDArray[np.int32]
    online: Trajectory | None = None
    stats: dict[str, Any] = field(default_factory=dict)

    @property
    def tracked_frames(self) -> int:
        """Number of frames with a pose."""
        return len(self.trajectory)


@dataclass(frozen=True)
class DepthPrediction:
    """The depth maps of a batch, finest first.

    Attributes:
        depths: Tensors (B, 1, H_s, W_s), positive, differentiable; metres if the estimator is metric, else up to scale.
        disparities: The network's own inverse-depth-like output per scale, where it has one. The smoothness term is
            defined on it (Monodepth2); without it the term uses 1 / depth.
        sigma: (B, 1, H, W), positive: the standard deviation of the logarithm of the finest depth, without the error of
            scale that all of an image shares. None where the network does not predict it.
    """

    depths: tuple[torch.Tensor, ...]
    disparities: tuple[torch.Tensor, ...] | None = None
    sigma: torch.Tensor | None = None

    @property
    def depth(self) -> torch.Tensor:
        """The finest depth map, (B, 1, H, W)."""
        return self.depths[0]

    def inverse_depths(self) -> tuple[torch.Tensor, ...]:
        """The disparities, or 1 / depth where the network has none."""
        return self.disparities if self.disparities is not None else tuple(1.0 / d for d in self.depths)

    def __iter__(self) -> Iterator[torch.Tensor]:
        return iter(self.depths)
