"""Removing the distortion of a camera from its images and depth maps."""

from __future__ import annotations

from functools import singledispatch

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import PinholeCamera

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


@singledispatch
def undistortion_maps(camera: PinholeCamera) -> Maps:
    """Return where in the distorted image every pixel of the undistorted one lies: u and v, (H, W) each.

    Cameras with another lens than OpenCV's register their own.

    Args:
        camera: With OpenCV's radial-tangential distortion.
    """
    size, coefficients = (camera.width, camera.height), np.array(camera.distortion)
    u, v = cv2.initUndistortRectifyMap(camera.K, coefficients, np.eye(3), camera.K, size, cv2.CV_32FC1)
    return np.asarray(u, np.float32), np.asarray(v, np.float32)


class Undistorter:
    """Moves the pixels of a distorted camera to where its pinhole camera of the same intrinsics would have seen them.

    It does nothing for a camera without distortion.

    Args:
        camera: The camera; ``camera.undistorted()`` is that of the images that come out.
        maps: Where each pixel that comes out lies, u and v (H, W), if another camera's images come out, as where a
            stereo pair is rectified; None for ``undistortion_maps`` of the camera.
    """

    def __init__(self, camera: PinholeCamera, maps: Maps | None = None) -> None:
        self._maps = undistortion_maps(camera) if maps is None and any(camera.distortion) else maps

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the undistorted (H, W, 3) image; what the camera did not see is black."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR), np.uint8)

    def depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the undistorted (H, W) depth by nearest neighbours, so that no depth between two surfaces arises."""
        if self._maps is None:
            return depth
        return np.asarray(cv2.remap(depth, *self._maps, cv2.INTER_NEAREST), np.float32)
