"""A small made-up scene on which any SLAM system can be tried."""

from __future__ import annotations

import numpy as np

from prgbd.core.types import Frame, PinholeCamera


def planar_scene(count: int = 8, width: int = 320, height: int = 240) -> list[Frame]:
    """Make frames of a camera (60 degrees field of view) that slides along a textured wall 2 m away.

    Args:
        count: Number of frames.
        width: Image width in pixels.
        height: Image height in pixels.

    Returns:
        Frames with exact depth, and right images of a pair with a baseline of 0.1 m.
    """
    import cv2

    rng = np.random.default_rng(0)
    focal, distance, step = PinholeCamera.from_fov(width, height, 60.0).fx, 2.0, 3
    canvas = np.kron(rng.integers(0, 256, (height // 8 + 1, width // 8 + 40, 3), dtype=np.uint8), np.ones((8, 8, 1)))
    canvas = np.asarray(cv2.GaussianBlur(canvas.astype(np.uint8), (5, 5), 1.0))
    shift = round(focal * 0.1 / distance)
    frames = []
    for i in range(count):
        left, right = (canvas[:height, i * step + o : i * step + o + width] for o in (0, shift))
        depth = np.full((height, width), distance, np.float32)
        frames.append(Frame(i, i * 0.1, np.ascontiguousarray(left), depth, np.ascontiguousarray(right)))
    return frames
