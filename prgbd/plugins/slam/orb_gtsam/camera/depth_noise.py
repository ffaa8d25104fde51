"""How far a measured depth may be off, and what that means for the column in the (virtual) right image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.settings import AUTO, DepthOptions

FloatArray = NDArray[np.float64]

# Half side, in pixels, of the neighbourhood whose depth must agree where borders are told apart.
BORDER_RADIUS = 4


@dataclass(frozen=True)
class DepthNoise:
    """Standard deviation of a measured depth d, ``d * (relative + far * d / baseline)``, and how errors are related.

    A sensor that triangulates (stereo, Kinect) errs with the square of the depth, which is a constant error of
    ``u_right``: ORB-SLAM2's one pixel. A network errs in proportion to the depth, so near points, whose disparity is
    large, err by many pixels. Its errors are no independent draws either: a network that sees a street too large sees
    all of it too large, in this frame and the next. N observations with such a common error tell no more than one, so
    the optimisers divide their weight by ``shared``; the choice between depth and triangulation and the chi-square
    tests of single points do not.

    Attributes:
        relative: Share of the depth.
        far: Growth of that share per baseline of depth.
        shared: Observations that err together.
        fallback: Whether observations whose depth disagrees go on as monocular ones, instead of being outliers.
        border: Largest relative difference of depth around a keypoint that makes a stereo observation; 0 allows any.
    """

    relative: float = 0.0
    far: float = 0.0
    shared: float = 1.0
    fallback: bool = False
    border: float = 0.0

    @property
    def is_zero(self) -> bool:
        """Whether ``u_right`` is as accurate as the keypoint."""
        return self.relative == 0 and self.far == 0

    def of_right(self, depth: NDArray[np.floating], fx: float, baseline: float) -> FloatArray:
        """Return the standard deviation of ``u_right`` that the errors of depths bring.

        Args:
            depth: (N,) metres, 0 where there is none.
            fx: Focal length, pixels.
            baseline: Metres.

        Returns:
            (N,) pixels, ``fx * baseline / d^2`` times the depth's; 0 where there is no depth.
        """
        d = np.asarray(depth, np.float64)
        known = d > 0
        return np.where(known, fx * (self.relative * baseline / np.where(known, d, 1.0) + self.far), 0.0)


# What "auto" means for the depth of a network: single depths are wrong by 10 to 20 %.
PSEUDO_DEPTH = DepthNoise(relative=0.15, fallback=True)


# Depth that was made to fit the map says nothing new about poses: weighed in (by half of the keypoints in place of so
# many), it took KITTI 00 from .31 to .47 m.
_NO_SAY = 100_000.0


def depth_noise(options: DepthOptions, mode: str, features: int) -> DepthNoise:
    """Return the noise of the depth of a mode of the system, for so many features in a frame."""
    pseudo = mode == "pseudo_rgbd"
    automatic = PSEUDO_DEPTH if pseudo else DepthNoise()
    # About half of a frame's keypoints are found in the map.
    shared = _NO_SAY if options.follows(mode) else max(1.0, 0.5 * features) if pseudo else 1.0
    return DepthNoise(
        relative=automatic.relative if options.sigma == AUTO else options.sigma,
        far=options.sigma_far,
        shared=shared if options.shared == AUTO else options.shared,
        fallback=automatic.fallback if options.fallback == AUTO else options.fallback,
        border=options.border,
    )


def spread_around(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how much depth differs around every pixel: (largest - smallest) / largest within ``BORDER_RADIUS``.

    Unknown depth (0) around a pixel does not count.

    Args:
        depth: (H, W) float32 metres, 0 where unknown.

    Returns:
        (H, W) float32 from 0 (flat) to 1 (the edge of something near).
    """
    kernel = np.ones((2 * BORDER_RADIUS + 1, 2 * BORDER_RADIUS + 1), np.uint8)
    far = cv2.dilate(depth, kernel)
    near = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)).astype(np.float32), kernel)
    return np.asarray(np.where(far > 0, (far - np.minimum(near, far)) / np.maximum(far, 1e-9), 0.0), np.float32)
