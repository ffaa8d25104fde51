"""Rectifying a stereo pair: both images as two parallel cameras side by side would have seen them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.core.types import PinholeCamera
from prgbd.core.undistortion import Undistorter
from prgbd.plugins.data._lens import FisheyeCamera

MOST_TURNED = 30.0  # degrees between the two directions of view that rectification still leaves an image of


class Rectification:
    """How the images of two cameras become those of one rectified pair, by OpenCV (Bouguet's algorithm).

    Of the rectified images every pixel was seen; they lose a little at the edges.

    Args:
        left: The left camera with its distortion.
        right: The right one, of images of the same size.
        rTl: (4, 4) metres, maps coordinates of the left camera to those of the right one.
        source: The recording, for messages.

    Attributes:
        camera: The camera of both rectified images.
        baseline: Metres from the left to the right one.
        lTn: (4, 4) maps coordinates of the rectified left camera to those of the left camera: a rotation.
        left: Rectifies left images.
        right: Rectifies right images.

    Raises:
        DataError: If the two cannot be rectified.
    """

    def __init__(self, left: PinholeCamera, right: PinholeCamera, rTl: NDArray[np.float64], source: Path) -> None:
        size = (left.width, left.height)
        self._check(left, right, rTl, source)
        lenses = [np.array(camera.distortion or (0.0,) * 4) for camera in (left, right)]
        turn_left, turn_right, P_left, P_right, *_ = cv2.stereoRectify(
            *(left.K, lenses[0], right.K, lenses[1], size, rTl[:3, :3].copy(), rTl[:3, 3:].copy()),
            flags=cv2.CALIB_ZERO_DISPARITY,
            alpha=0,
        )
        self.baseline = float(-P_right[0, 3] / P_right[0, 0])
        if not self.baseline > 0:
            raise DataError(
                f"By the T_BS of their sensor.yaml cam1 of {source} stands {-self.baseline:.3g} m left of cam0, and "
                "must be the right one; set data.stereo=false, or mend the files."
            )
        P = np.asarray(P_left, np.float64)
        self.camera = PinholeCamera(*size, float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
        self.lTn = np.eye(4)
        self.lTn[:3, :3] = np.asarray(turn_left).T
        turns = (turn_left, turn_right)
        self.left, self.right = (
            Undistorter(
                camera,
                maps=cv2.initUndistortRectifyMap(camera.K, lens, turn, P[:, :3], size, cv2.CV_32FC1),  # type: ignore[arg-type]
            )
            for camera, lens, turn in zip((left, right), lenses, turns, strict=True)
        )

    @staticmethod
    def _check(left: PinholeCamera, right: PinholeCamera, rTl: NDArray[np.float64], source: Path) -> None:
        mend = "set data.stereo=false to read cam0 alone"
        if isinstance(left, FisheyeCamera) or isinstance(right, FisheyeCamera):
            raise DataError(f"The fisheye lenses of {source} cannot be rectified as a stereo pair; {mend}.")
        if (left.width, left.height) != (right.width, right.height):
            raise DataError(f"The images of cam0 and cam1 of {source} differ in size; {mend}.")
        apart = float(np.degrees(np.arccos(np.clip(rTl[2, 2], -1, 1))))
        if apart > MOST_TURNED or abs(rTl[0, 3]) < max(abs(rTl[1, 3]), abs(rTl[2, 3])):
            raise DataError(
                f"By the T_BS of their sensor.yaml cam1 of {source} does not stand beside cam0 with the same view "
                f"({apart:.0f} degrees apart); {mend}, or mend the files."
            )
