"""Makes exact depth as wrong as a monocular network's: biased, wandering in scale, blurred at borders."""

from __future__ import annotations

import cv2
import numpy as np

from prgbd.core.types import Frame


class WrongDepth:
    """Corrupts the depth of frames in order; errors persist from frame to frame, as a network's do.

    Args:
        near_bias: Relative error of what is nearest; it fades towards the largest depth.
        scale: Standard deviation of the logarithm of the frames' scale, which wanders.
        patches: The same for patches of a sixth of the image, which change with the scale.
        memory: Frames over which errors are forgotten.
        blur: Pixels over which borders smear.
        seed: Of the errors.
    """

    def __init__(
        self,
        *,
        near_bias: float = 0.0,
        scale: float = 0.0,
        patches: float = 0.0,
        memory: float = 20.0,
        blur: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.near_bias, self.scale, self.patches, self.blur = near_bias, scale, patches, blur
        self._rng = np.random.default_rng(seed)
        self._keep = np.exp(-1.0 / memory)
        self._scale, self._field = self._rng.standard_normal(), self._rng.standard_normal((6, 6))

    def __call__(self, frame: Frame) -> Frame:
        """Return the frame with wrong depth; unknown depth stays unknown."""
        assert frame.depth is not None
        fresh = np.sqrt(1 - self._keep**2)
        self._scale = self._keep * self._scale + fresh * self._rng.standard_normal()
        self._field = self._keep * self._field + fresh * self._rng.standard_normal((6, 6))
        depth, known = frame.depth, frame.depth > 0
        size = (depth.shape[1], depth.shape[0])
        log = self.scale * self._scale + self.patches * cv2.resize(self._field, size, interpolation=cv2.INTER_CUBIC)
        farness = depth / max(float(depth.max()), 1e-9)
        wrong = depth * np.exp(log) * (1.0 + self.near_bias * (1.0 - farness))
        if self.blur > 0:
            weight = cv2.GaussianBlur(known.astype(np.float64), (0, 0), self.blur)
            wrong = cv2.GaussianBlur(np.where(known, wrong, 0.0), (0, 0), self.blur) / np.maximum(weight, 1e-9)
        return frame.with_depth(np.where(known, wrong, 0.0).astype(np.float32))
