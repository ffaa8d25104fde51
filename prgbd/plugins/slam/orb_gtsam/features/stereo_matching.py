"""Depth of keypoints from a rectified stereo pair: descriptors along rows, then a sub-pixel search by intensities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import resize_pixels
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.features.matching import hamming
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

# ORB-SLAM2 (Frame::ComputeStereoMatches): rows within 2 pixels of the right keypoint's level, a distance of at most the
# mean of TH_HIGH and TH_LOW, windows of 11 x 11 pixels moved by up to 5, outliers beyond 1.5 * 1.4 medians.
_ROWS = 2.0
_HALF_WINDOW = 5
_HALF_SEARCH = 5
_OUTLIER = 1.5 * 1.4
_LEAST_DISPARITY = 0.01


def match_stereo(
    left: Features,
    right: Features,
    left_levels: list[NDArray[np.uint8]],
    right_levels: list[NDArray[np.uint8]],
    size: tuple[int, int],
    bf: float,
    nearest: float,
    limit: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Match the keypoints of the left image to the right one.

    Args:
        left: Keypoints of the left image.
        right: Keypoints of the right image.
        left_levels: Grey pyramid of the left image, finest first.
        right_levels: The same of the right image.
        size: Width and height of the images, pixels.
        bf: Baseline times fx, metres times pixels.
        nearest: Least depth, metres.
        limit: Largest Hamming distance.

    Returns:
        Depth in metres, 0 where there is no match, and column in the right image in pixels, -1 where there is none;
        both (N,) float32.
    """
    scales = np.array([[size[0] / level.shape[1], size[1] / level.shape[0]] for level in left_levels])
    height = size[1]
    start, members = _rows_of(right.uv, right.octave, scales, height)
    partner = _partners(
        left.uv,
        left.octave,
        left.descriptor,
        right.uv,
        right.octave,
        right.descriptor,
        start,
        members,
        bf / nearest,
        limit,
    )
    shift = np.full(len(left), np.nan)
    difference = np.full(len(left), np.inf)
    for octave, (a, b) in enumerate(zip(left_levels, right_levels, strict=True)):
        rows = np.flatnonzero((partner >= 0) & (left.octave == octave))
        if len(rows):
            at = _nearest_pixels(left.uv[rows], scales[octave])
            at_right = _nearest_pixels(right.uv[partner[rows]], scales[octave])
            shift[rows], difference[rows] = _refine(a, b, at, at_right)
    found = np.isfinite(difference)
    if found.any():
        found &= difference <= _OUTLIER * np.median(difference[found])
    disparity = shift * scales[left.octave, 0]
    with np.errstate(invalid="ignore"):
        found &= (disparity >= 0) & (disparity < bf / nearest)
    disparity = np.maximum(np.where(found, disparity, 1.0), _LEAST_DISPARITY)
    depth = np.where(found, bf / disparity, 0.0).astype(np.float32)
    u_right = np.where(found, left.uv[:, 0] - disparity, -1.0).astype(np.float32)
    # A column left of the image would read as "none".
    depth[u_right < 0], u_right[u_right < 0] = 0.0, -1.0
    return depth, u_right


def _nearest_pixels(uv: NDArray[np.float32], scale: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the nearest pixels (N, 2) of a pyramid level that is smaller by ``scale`` (2,)."""
    return np.round(resize_pixels(uv.astype(np.float64), 1 / scale)).astype(np.int64)


@kernel()
def _rows_of(uv: np.ndarray, octave: np.ndarray, scales: np.ndarray, height: int) -> tuple[np.ndarray, np.ndarray]:
    """List the keypoints that may match each image row, as starts (height + 1,) and members."""
    count = np.zeros(height + 1, np.int64)
    first, last = np.empty(len(uv), np.int64), np.empty(len(uv), np.int64)
    for i in range(len(uv)):
        reach = _ROWS * scales[octave[i], 1]
        first[i] = max(int(np.floor(uv[i, 1] - reach)), 0)
        last[i] = min(int(np.ceil(uv[i, 1] + reach)), height - 1)
        for row in range(first[i], last[i] + 1):
            count[row + 1] += 1
    start = np.cumsum(count)
    members = np.empty(start[-1], np.int64)
    at = start[:-1].copy()
    for i in range(len(uv)):
        for row in range(first[i], last[i] + 1):
            members[at[row]] = i
            at[row] += 1
    return start, members


@kernel()
def _partners(
    uv: np.ndarray,
    octave: np.ndarray,
    descriptor: np.ndarray,
    right_uv: np.ndarray,
    right_octave: np.ndarray,
    right_descriptor: np.ndarray,
    start: np.ndarray,
    members: np.ndarray,
    most: float,
    limit: int,
) -> np.ndarray:
    """Find the right keypoint with the nearest descriptor on the row of each left one, (N,) with -1 for none."""
    partner = np.full(len(uv), -1, np.int64)
    for i in range(len(uv)):
        row = min(max(int(np.round(uv[i, 1])), 0), len(start) - 2)
        best = limit
        for m in range(start[row], start[row + 1]):
            j = members[m]
            if abs(right_octave[j] - octave[i]) > 1:
                continue
            disparity = uv[i, 0] - right_uv[j, 0]
            if disparity < -1.0 or disparity > most:
                continue
            d = hamming(descriptor[i], right_descriptor[j])
            if d < best:
                best, partner[i] = d, j
    return partner


@kernel()
def _difference(left: np.ndarray, right: np.ndarray, x: int, x_right: int, y: int) -> float:
    """Sum of absolute differences of two windows after their means are taken away."""
    w = _HALF_WINDOW
    n = (2 * w + 1) ** 2
    mean = 0.0
    for dy in range(-w, w + 1):
        for dx in range(-w, w + 1):
            mean += float(left[y + dy, x + dx]) - float(right[y + dy, x_right + dx])
    mean /= n
    total = 0.0
    for dy in range(-w, w + 1):
        for dx in range(-w, w + 1):
            total += abs(float(left[y + dy, x + dx]) - float(right[y + dy, x_right + dx]) - mean)
    return total


@kernel()
def _refine(
    left: np.ndarray, right: np.ndarray, pixel: np.ndarray, right_pixel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Search around the right keypoints; return disparity in pixels of the level and the difference there.

    Keypoints are whole pixels (N, 2) of the level. The difference is infinite where the best place lies at the end of
    the search, or has no minimum.
    """
    height, width = left.shape
    reach = _HALF_WINDOW + _HALF_SEARCH
    shift, difference = np.full(len(pixel), np.nan), np.full(len(pixel), np.inf)
    at = np.empty(2 * _HALF_SEARCH + 1)
    for i in range(len(pixel)):
        (x, y), x_right = pixel[i], right_pixel[i, 0]
        if y < _HALF_WINDOW or y >= height - _HALF_WINDOW or x < _HALF_WINDOW or x >= width - _HALF_WINDOW:
            continue
        if x_right < reach or x_right >= width - reach:
            continue
        for k in range(len(at)):
            at[k] = _difference(left, right, x, x_right + k - _HALF_SEARCH, y)
        best = int(np.argmin(at))
        if best == 0 or best == len(at) - 1:
            continue
        curvature = at[best - 1] + at[best + 1] - 2.0 * at[best]
        if curvature <= 0:
            continue
        offset = 0.5 * (at[best - 1] - at[best + 1]) / curvature
        shift[i] = x - (x_right + best - _HALF_SEARCH + offset)
        difference[i] = at[best]
    return shift, difference
