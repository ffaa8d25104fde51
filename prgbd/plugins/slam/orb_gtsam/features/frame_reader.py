"""From a frame as it is given to keypoints as the system uses them: checked, undistorted, with depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, ContractError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.camera.undistortion import Undistortion
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features, OrbExtractor
from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_HIGH, DISTANCE_LOW
from prgbd.plugins.slam.orb_gtsam.features.stereo_matching import match_stereo
from prgbd.plugins.slam.orb_gtsam.settings import FeatureOptions

_WITH_DEPTH = ("rgbd", "pseudo_rgbd")


class FrameReader:
    """Finds the keypoints of frames.

    Args:
        options: Pyramid, thresholds and the number of features.
        camera: The camera as it is, distorted or not.
        mode: ``mono``, ``rgbd``, ``pseudo_rgbd`` or ``stereo``.

    Raises:
        ConfigError: If a stereo camera is distorted.
    """

    def __init__(self, options: FeatureOptions, camera: PinholeCamera, mode: str) -> None:
        self.camera, self.mode = camera, mode
        distorted = any(camera.distortion)
        if distorted and mode == "stereo":
            raise ConfigError(
                "Mode 'stereo' needs rectified images, but the camera has distortion; rectify them first."
            )
        self.left = OrbExtractor(options, camera.width, camera.height)
        self._right = OrbExtractor(options, camera.width, camera.height) if mode == "stereo" else None
        self.lens = Undistortion(camera) if distorted else None

    def check(self, frame: Frame) -> None:
        """Refuse a frame that does not fit camera and mode.

        Raises:
            ContractError: If an image or depth is missing or has another shape.
        """
        shape = (self.camera.height, self.camera.width)
        self._check_image(frame.index, "an image", frame.image, shape)
        if self.mode in _WITH_DEPTH and (frame.depth is None or frame.depth.shape != shape):
            found = None if frame.depth is None else frame.depth.shape
            raise ContractError(
                f"Frame {frame.index} has depth {found}, but mode '{self.mode}' needs {shape}; use 'mono'."
            )
        if self.mode == "stereo":
            if frame.right is None:
                raise ContractError(
                    f"Frame {frame.index} has no right image, which mode 'stereo' needs; leave out the frames without "
                    "one, or use mode 'mono'."
                )
            self._check_image(frame.index, "a right image", frame.right, shape)

    def _check_image(self, index: int, what: str, image: NDArray[np.uint8], shape: tuple[int, int]) -> None:
        if image.shape != (*shape, 3) or image.dtype != np.uint8:
            raise ContractError(
                f"Frame {index} has {what} {image.shape} {image.dtype}; the camera asks for {(*shape, 3)} uint8 RGB."
            )

    def read(self, frame: Frame, camera: CameraModel) -> Features:
        """Find the keypoints of a frame, in undistorted pixels, with depth where the mode has it."""
        depth = frame.depth if self.mode in _WITH_DEPTH else None
        features = self.left.extract(
            frame.image, depth, camera.bf, camera.trusted_depth, camera.noise.border, undistort=self.lens
        )
        if self._right is None or frame.right is None:
            return features
        right = self._right.extract(frame.right, None, camera.bf)
        limit = (DISTANCE_HIGH + DISTANCE_LOW) // 2
        measured, u_right = match_stereo(
            features,
            right,
            self.left.pyramid,
            self._right.pyramid,
            (self.camera.width, self.camera.height),
            camera.bf,
            camera.baseline,
            limit,
        )
        return replace(features, depth=measured, u_right=u_right)
