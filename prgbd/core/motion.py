"""How much the picture moves between two images: a quick look, for what comes before a run."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH = 320
"""Pixels that images are shrunk to; motion is in pixels at this width."""
MIN_CORNERS = 10


def small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an (H, W, 3) RGB image as grey levels, ``WIDTH`` pixels wide."""
    height = max(16, round(image.shape[0] * WIDTH / image.shape[1]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey, (WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)


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
