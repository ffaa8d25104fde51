"""How much the picture moves between two images: a quick look, for what comes before a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import PinholeCamera

WIDTH = 320
"""Pixels that images are shrunk to; motion is in pixels at this width."""
MIN_CORNERS = 10


def small(image: NDArray[np.uint8], width: int = WIDTH) -> NDArray[np.uint8]:
    """Return an (H, W, 3) RGB image as grey levels, ``width`` pixels wide."""
    height = max(16, round(image.shape[0] * width / image.shape[1]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def followed(
    first: NDArray[np.uint8], second: NDArray[np.uint8], corners: int = 200
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Follow corners of one grey image to another.

    Returns:
        Where they are in both images, (N, 2) each, or None where there are too few.
    """
    found = cv2.goodFeaturesToTrack(first, corners, 0.01, 7)
    if found is None or len(found) < MIN_CORNERS:
        return None
    moved, status, _ = cv2.calcOpticalFlowPyrLK(first, second, found, None)  # type: ignore[call-overload]
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, moved, None)  # type: ignore[call-overload]
    kept = (status.ravel() == 1) & (again.ravel() == 1) & (np.linalg.norm((back - found)[:, 0], axis=1) < 1.0)
    if kept.sum() < MIN_CORNERS:
        return None
    return found[kept, 0], moved[kept, 0]


def median_motion(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float | None:
    """Return the median motion of corners between two grey images in pixels, or None where there are too few."""
    pair = followed(first, second)
    return None if pair is None else float(np.median(np.linalg.norm(pair[1] - pair[0], axis=1)))


@dataclass(frozen=True)
class Turning:
    """How well a rotation of the camera alone explains what moved between two images.

    Attributes:
        motion: Median motion, pixels.
        left_over: For every factor on the focal length, the part of ``motion`` that the best rotation leaves.
    """

    motion: float
    left_over: NDArray[np.float64]


def turning(
    first: NDArray[np.float32], second: NDArray[np.float32], camera: PinholeCamera, factors: Sequence[float] = (1.0,)
) -> Turning:
    """Fit a rotation to corners followed between two ``small`` images.

    Args:
        first: (N, 2) pixels in the one image.
        second: (N, 2) pixels in the other.
        camera: The camera of the images as they were.
        factors: What to multiply its focal length with.
    """
    shrunk = camera.resized(WIDTH, max(16, round(camera.height * WIDTH / camera.width)))
    motion = float(np.median(np.linalg.norm(second - first, axis=1)))
    left = []
    for factor in factors:
        f = np.array([shrunk.fx * factor, shrunk.fy * factor])
        a, b = (np.c_[(pixels - (shrunk.cx, shrunk.cy)) / f, np.ones(len(pixels))] for pixels in (first, second))
        turned = a @ _rotation(a, b).T
        off = (turned[:, :2] / turned[:, 2:] - b[:, :2]) * f
        left.append(float(np.median(np.linalg.norm(off, axis=1))) / max(motion, 1e-9))
    return Turning(motion, np.array(left))


def _rotation(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation that takes directions ``a`` to ``b`` (Kabsch), fitted anew to those that agree."""
    a, b = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (a, b))
    agree = np.ones(len(a), bool)
    R = np.eye(3)
    for _ in range(5):
        U, _, Vt = np.linalg.svd(b[agree].T @ a[agree])
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        off = np.linalg.norm(b - a @ R.T, axis=1)
        agree = off <= 2.5 * np.median(off) + 1e-9
    return R
