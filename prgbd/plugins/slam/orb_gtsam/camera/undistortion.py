"""Keypoints of a distorted camera, moved to where an ideal pinhole camera would have seen them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import PinholeCamera


class Undistortion:
    """Moves pixels of a distorted image to the undistorted one of the same intrinsics.

    Args:
        camera: With OpenCV's distortion coefficients.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self._K = camera.K
        self._coefficients = np.array(camera.distortion, np.float64)
        self._size = np.array([camera.width, camera.height])

    def back(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the distorted image shows undistorted pixels, (N, 2)."""
        if len(uv) == 0:
            return uv
        rays = np.concatenate([(uv - self._K[:2, 2]) / self._K[[0, 1], [0, 1]], np.ones((len(uv), 1))], axis=1)
        return np.asarray(cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self._K, self._coefficients)[0][:, 0])

    def __call__(self, uv: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Undistort pixels.

        Args:
            uv: (N, 2) pixels of the distorted image.

        Returns:
            (N, 2) float32 undistorted pixels, and (N,) bool whether they lie within the image.
        """
        if len(uv) == 0:
            return uv, np.zeros(0, np.bool_)
        moved = cv2.undistortPoints(uv.astype(np.float64)[:, None], self._K, self._coefficients, P=self._K)[
            :, 0
        ].astype(np.float32)
        return moved, np.all((moved >= -0.5) & (moved <= self._size - 0.5), axis=1)
