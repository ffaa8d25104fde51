"""Removing the distortion of a camera from its images and depth maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import PinholeCamera


class Undistorter:
    """Moves the pixels of a distorted camera to where its pinhole camera of the same intrinsics would have seen them.

    It does nothing for a camera without distortion.

    Args:
        camera: The camera; ``camera.undistorted()`` is that of the images that come out.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self._maps: tuple[Any, Any] | None = camera.undistortion_maps() if any(camera.distortion) else None

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the undistorted (H, W, 3) image; what the camera did not see is black."""
        if self._maps is None:
            return image
        import cv2

        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR), np.uint8)

    def depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the undistorted (H, W) depth by nearest neighbours, so that no depth between two surfaces arises."""
        if self._maps is None:
            return depth
        import cv2

        return np.asarray(cv2.remap(depth, *self._maps, cv2.INTER_NEAREST), np.float32)
