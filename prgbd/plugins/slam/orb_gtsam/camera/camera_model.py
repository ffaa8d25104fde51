"""The camera as the SLAM system uses it: intrinsics, (virtual) baseline and pyramid."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam.orb_gtsam.camera.chi_square import CHI2_MONO, CHI2_STEREO
from prgbd.plugins.slam.orb_gtsam.camera.depth_noise import DepthNoise
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

if TYPE_CHECKING:
    from prgbd.plugins.slam.orb_gtsam.features.extraction import Features

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


# Standard deviations of the measured depth that a search window is widened by.
_SLACK = 2.0


@dataclass
class CameraModel:
    """Camera, baseline and pyramid of one sequence.

    Attributes:
        pinhole: The pinhole camera, without distortion; self-calibration replaces it.
        mono: Whether there is no depth.
        baseline: Metres between the (virtual) stereo pair, 0 for mono.
        close_depth: Depths below count as close, metres (or the unit of the depth).
        scales: (levels,) scale of every pyramid level.
        columns: Grid cells per row.
        trusted_depth: Depths beyond make no stereo observation; infinite by default.
        stereo: Whether depth comes from a real right image.
        noise: How far measured depths may be off.
        affine: Whether measured inverse depth is only known up to scale and shift, which every frame's place in the map
            tells; what needs a unit before that does without.
    """

    pinhole: PinholeCamera
    mono: bool
    baseline: float
    close_depth: float
    scales: FloatArray
    columns: int
    trusted_depth: float = np.inf
    stereo: bool = False
    noise: DepthNoise = field(default_factory=DepthNoise)
    affine: bool = False

    @property
    def without_unit(self) -> bool:
        """Whether maps start from two views, each in a unit of its own."""
        return self.mono or self.affine

    @property
    def mode(self) -> str:
        """``mono``, ``rgbd`` or ``stereo``."""
        return "stereo" if self.stereo else "mono" if self.mono else "rgbd"

    @property
    def bf(self) -> float:
        """Baseline times focal length."""
        return self.baseline * self.pinhole.fx

    @property
    def intrinsics(self) -> tuple[float, float, float, float, float]:
        """``fx, fy, cx, cy, bf`` as the optimisers take them."""
        c = self.pinhole
        return c.fx, c.fy, c.cx, c.cy, self.bf

    @property
    def inverse_variance(self) -> FloatArray:
        """Inverse variance of a keypoint of every pyramid level, 1 / px^2."""
        return 1.0 / self.scales**2

    def weights(
        self, octave: NDArray[np.int32], depth: NDArray[np.float32], *, shared: float | None = None
    ) -> FloatArray:
        """Return the inverse variances of observations as the optimisers take them.

        Args:
            octave: (N,) pyramid levels.
            depth: (N,) measured depths, 0 where there is none.
            shared: Observations that err together, by default ``noise.shared``; 1 judges each by itself.

        Returns:
            (N,) if depth is as accurate as the keypoint, else (N, 2): of ``(u, v)`` and of ``u_right``, whose variance
            is the keypoint's plus what the depth brings.
        """
        pixel = self.inverse_variance[octave]
        shared = self.noise.shared if shared is None else shared
        if self.noise.is_zero:
            return pixel
        right = 1.0 / pixel + shared * self.right_sigma(depth) ** 2
        return np.stack([pixel, 1.0 / right], axis=1)

    def right_sigma(self, depth: NDArray[np.floating]) -> FloatArray:
        """Return the standard deviation (N,) of right columns, pixels, that the errors of depths (N,) bring."""
        return self.noise.of_right(depth, self.pinhole.fx, self.baseline)

    def right_slack(self, depth: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Return by how many pixels (N,) the right columns of depths (N,) may be off beyond a search window."""
        if self.noise.is_zero:
            return None
        return (_SLACK * self.right_sigma(depth)).astype(np.float32)

    def rays(self, uv: NDArray[np.float32]) -> FloatArray:
        """Return normalised image coordinates (N, 2) of pixels (N, 2)."""
        c = self.pinhole
        return (uv.astype(np.float64) - (c.cx, c.cy)) / (c.fx, c.fy)

    def lift(self, features: Features, rows: IntArray, wTc: FloatArray, ratio: float = 1.0) -> FloatArray:
        """Return world points (N, 3) of keypoints with measured depth, which is ``ratio`` times that of the map."""
        in_camera = self.pinhole.backproject(features.uv[rows], features.depth[rows] / ratio)
        return in_camera @ wTc[:3, :3].T + wTc[:3, 3]

    def measured(self, features: Features, rows: IntArray) -> FloatArray:
        """Return observations ``(u, v, u_right)``, (N, 3) float64, of keypoints."""
        return measurements(features.uv[rows], features.u_right[rows])

    def fits(
        self, features: Features, rows: IntArray, uvr: FloatArray, *, depth_counts: bool | None = None
    ) -> NDArray[np.bool_]:
        """Return whether projections (N, 3) agree with their keypoints by the chi-square test, (N,) bool.

        Where the depth does not count, pixels that fit are enough; by default that is so with ``noise.fallback``.
        """
        error = self.measured(features, rows) - uvr
        stereo = features.u_right[rows] >= 0
        weight = self.weights(features.octave[rows], features.depth[rows], shared=1.0)
        pixel, right = (weight, weight) if weight.ndim == 1 else weight.T
        mono = (error[:, 0] ** 2 + error[:, 1] ** 2) * pixel
        both = mono + np.where(stereo, error[:, 2] ** 2 * right, 0.0)
        fit = both <= np.where(stereo, CHI2_STEREO, CHI2_MONO)
        if depth_counts is None:
            depth_counts = not self.noise.fallback
        return np.asarray(fit if depth_counts else fit | (mono <= CHI2_MONO))

    def project(
        self,
        xyz: FloatArray,
        normal: FloatArray,
        distance_range: FloatArray,
        cTw: FloatArray,
        least_cosine: float = 0.5,
    ) -> Projections:
        """Project map points into a camera and predict how they appear there.

        Args:
            xyz: (N, 3) world points.
            normal: (N, 3) mean viewing directions.
            distance_range: (N, 2) distances between which a point's scale stays inside the pyramid.
            cTw: (4, 4) world to camera.
            least_cosine: Least cosine between the mean viewing direction and this one.
        """
        c = self.pinhole
        return Projections(
            *_project(
                xyz,
                normal,
                distance_range,
                np.ascontiguousarray(cTw),
                c.fx,
                c.fy,
                c.cx,
                c.cy,
                0.0 if self.mono else self.bf,
                float(c.width),
                float(c.height),
                float(self.scales[1]) if len(self.scales) > 1 else 1.2,
                len(self.scales),
                least_cosine,
            )
        )


@dataclass(frozen=True)
class Projections:
    """Where points fall in an image.

    Attributes:
        uvr: (N, 3) pixels ``(u, v, u_right)``; ``u_right`` is -1 without a baseline.
        level: (N,) int64 predicted pyramid level.
        cosine: (N,) cosine between mean and present viewing direction.
        visible: (N,) bool, in front, inside the image, within range and seen from a known side.
    """

    uvr: FloatArray
    level: IntArray
    cosine: FloatArray
    visible: NDArray[np.bool_]


def measurements(uv: NDArray[np.floating], u_right: NDArray[np.floating]) -> FloatArray:
    """Join pixels (N, 2) and right columns (N,) to observations (N, 3) float64."""
    uvr = np.empty((len(uv), 3))
    uvr[:, :2] = uv
    uvr[:, 2] = u_right
    return uvr


@kernel()
def _project(
    xyz: np.ndarray,
    normal: np.ndarray,
    distance_range: np.ndarray,
    cTw: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    bf: float,
    width: float,
    height: float,
    factor: float,
    levels: int,
    least_cosine: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    n = len(xyz)
    uvr = np.full((n, 3), -1.0)
    level = np.zeros(n, np.int64)
    cosine = np.zeros(n)
    visible = np.zeros(n, np.bool_)
    ox = -(cTw[0, 0] * cTw[0, 3] + cTw[1, 0] * cTw[1, 3] + cTw[2, 0] * cTw[2, 3])
    oy = -(cTw[0, 1] * cTw[0, 3] + cTw[1, 1] * cTw[1, 3] + cTw[2, 1] * cTw[2, 3])
    oz = -(cTw[0, 2] * cTw[0, 3] + cTw[1, 2] * cTw[1, 3] + cTw[2, 2] * cTw[2, 3])
    per_level = 1.0 / np.log(factor)
    for i in range(n):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        zc = cTw[2, 0] * x + cTw[2, 1] * y + cTw[2, 2] * z + cTw[2, 3]
        if zc <= 1e-6:
            continue
        xc = cTw[0, 0] * x + cTw[0, 1] * y + cTw[0, 2] * z + cTw[0, 3]
        yc = cTw[1, 0] * x + cTw[1, 1] * y + cTw[1, 2] * z + cTw[1, 3]
        u, v = fx * xc / zc + cx, fy * yc / zc + cy
        uvr[i, 0], uvr[i, 1] = u, v
        if bf > 0:
            uvr[i, 2] = u - bf / zc
        if u < 0 or u >= width or v < 0 or v >= height:
            continue
        dx, dy, dz = x - ox, y - oy, z - oz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if distance < 0.8 * distance_range[i, 0] or distance > 1.2 * distance_range[i, 1]:
            continue
        cosine[i] = (dx * normal[i, 0] + dy * normal[i, 1] + dz * normal[i, 2]) / distance
        if cosine[i] < least_cosine:
            continue
        predicted = int(np.ceil(np.log(distance_range[i, 1] / distance) * per_level))
        level[i] = min(max(predicted, 0), levels - 1)
        visible[i] = True
    return uvr, level, cosine, visible
