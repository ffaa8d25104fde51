"""Matching of ORB descriptors: by projection within windows and by descriptor alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.features.extraction import GRID_CELL, Features
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

HISTOGRAM_BINS = 30
# ORB-SLAM2 (ORBmatcher::TH_HIGH, TH_LOW): largest Hamming distance of a match by projection, and by descriptor alone.
DISTANCE_HIGH, DISTANCE_LOW = 100, 50
_FAR = 1 << 20
_NO_ANGLES = np.zeros(0, np.float32)

IntArray = NDArray[np.int64]


@kernel(inline="always")
def hamming(a: np.ndarray, b: np.ndarray) -> int:
    """Return the number of different bits of two descriptors, (4,) uint64 each."""
    total = np.uint64(0)
    for i in range(4):
        v = a[i] ^ b[i]
        # The population count of 64 bits; LLVM recognises it and uses the processor's own.
        v = v - ((v >> np.uint64(1)) & np.uint64(0x5555555555555555))
        v = (v & np.uint64(0x3333333333333333)) + ((v >> np.uint64(2)) & np.uint64(0x3333333333333333))
        v = (v + (v >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        total += (v * np.uint64(0x0101010101010101)) >> np.uint64(56)
    return int(total)


@kernel()
def keep_common_rotation(match: np.ndarray, angles: np.ndarray, frame_angles: np.ndarray) -> None:
    """Undo matches whose rotation is not among the three commonest, in place."""
    counts = np.zeros(HISTOGRAM_BINS, np.int64)
    bins = np.full(len(match), -1, np.int64)
    for i in range(len(match)):
        if match[i] >= 0:
            turn = angles[i] - frame_angles[match[i]]
            if turn < 0:
                turn += 360.0
            bins[i] = int(np.round(turn * HISTOGRAM_BINS / 360.0)) % HISTOGRAM_BINS
            counts[bins[i]] += 1
    order = np.argsort(-counts)
    best = counts[order[0]]
    for i in range(len(match)):
        if bins[i] >= 0:
            kept = bins[i] == order[0]
            for k in range(1, 3):
                kept |= bins[i] == order[k] and counts[order[k]] >= 0.1 * best
            if not kept:
                match[i] = -1


@kernel()
def _by_window(
    uvr: np.ndarray,
    radius: np.ndarray,
    level_low: np.ndarray,
    level_high: np.ndarray,
    descriptors: np.ndarray,
    angles: np.ndarray,
    frame_uv: np.ndarray,
    frame_octave: np.ndarray,
    frame_descriptors: np.ndarray,
    frame_u_right: np.ndarray,
    slack: np.ndarray,
    frame_angles: np.ndarray,
    cell_start: np.ndarray,
    taken: np.ndarray,
    columns: int,
    cell: float,
    limit: int,
    ratio: float,
    exclusive: bool,
) -> np.ndarray:
    n, rows = len(uvr), (len(cell_start) - 1) // columns
    match = np.full(n, -1, np.int64)
    owner = np.full(len(frame_uv), -1, np.int64)
    owner_distance = np.full(len(frame_uv), _FAR, np.int64)
    for i in range(n):
        u, v, r = uvr[i, 0], uvr[i, 1], radius[i]
        if not (abs(u) < _FAR and abs(v) < _FAR):
            continue
        c0, c1 = max(int((u - r) / cell), 0), min(int((u + r) / cell), columns - 1)
        r0, r1 = max(int((v - r) / cell), 0), min(int((v + r) / cell), rows - 1)
        if c0 > c1 or r0 > r1:
            continue
        best, second, best_index = _FAR, _FAR, -1
        best_level, second_level = -1, -2
        for row in range(r0, r1 + 1):
            # Keypoints are sorted by cell, so the cells of a row are one range.
            for k in range(cell_start[row * columns + c0], cell_start[row * columns + c1 + 1]):
                level = frame_octave[k]
                if taken[k] or level < level_low[i] or level > level_high[i]:
                    continue
                if abs(frame_uv[k, 0] - u) > r or abs(frame_uv[k, 1] - v) > r:
                    continue
                right = r + slack[k] if len(slack) > 0 else r
                if uvr[i, 2] >= 0 and frame_u_right[k] >= 0 and abs(frame_u_right[k] - uvr[i, 2]) > right:
                    continue
                d = hamming(descriptors[i], frame_descriptors[k])
                if d < best:
                    second, second_level = best, best_level
                    best, best_level, best_index = d, level, k
                elif d < second:
                    second, second_level = d, level
        if best > limit or (best_level == second_level and best > ratio * second):
            continue
        if exclusive:
            if best >= owner_distance[best_index]:
                continue
            if owner[best_index] >= 0:
                match[owner[best_index]] = -1
            owner[best_index], owner_distance[best_index] = i, best
        match[i] = best_index
    if len(angles) > 0:
        keep_common_rotation(match, angles, frame_angles)
    return match


def match_by_projection(
    uvr: NDArray[np.float64],
    radius: NDArray[np.float64],
    levels: tuple[IntArray, IntArray],
    descriptors: NDArray[np.uint64],
    frame: Features,
    columns: int,
    *,
    limit: int,
    ratio: float = 1.0,
    taken: NDArray[np.bool_] | None = None,
    angles: NDArray[np.float32] | None = None,
    exclusive: bool = True,
    slack: NDArray[np.float32] | None = None,
) -> IntArray:
    """Match projected points to the keypoints around them.

    Args:
        uvr: (M, 3) projections ``(u, v, u_right)`` in pixels; ``u_right < 0`` skips the comparison of depth.
        radius: (M,) half side of the window in pixels.
        levels: (M,) lowest and (M,) highest pyramid level that may match, int64.
        descriptors: (M, 4) uint64.
        frame: The keypoints.
        columns: Grid cells per row of ``frame``.
        limit: Largest Hamming distance.
        ratio: Largest ratio between the best and the second distance where both are on one level.
        taken: (N,) bool keypoints that may not match.
        angles: (M,) float32 degrees to hold matches to a common rotation, or None.
        exclusive: Whether a keypoint goes to its nearest point only.
        slack: (N,) float32 pixels by which the right column of a keypoint may lie outside the window, or None.

    Returns:
        (M,) int64 keypoint of every point, -1 for none.
    """
    if taken is None:
        taken = np.zeros(len(frame), np.bool_)
    matched: IntArray = _by_window(
        np.ascontiguousarray(uvr, np.float64),
        np.ascontiguousarray(radius, np.float64),
        levels[0],
        levels[1],
        descriptors,
        _NO_ANGLES if angles is None else angles,
        frame.uv,
        frame.octave,
        frame.descriptor,
        frame.u_right,
        _NO_ANGLES if slack is None else slack,
        frame.angle,
        frame.cell_start,
        taken,
        columns,
        GRID_CELL,
        limit,
        ratio,
        exclusive,
    )
    return matched


@kernel()
def _brute_force(
    descriptors: np.ndarray,
    angles: np.ndarray,
    frame_descriptors: np.ndarray,
    frame_angles: np.ndarray,
    limit: int,
    ratio: float,
) -> np.ndarray:
    match = np.full(len(descriptors), -1, np.int64)
    owner = np.full(len(frame_descriptors), -1, np.int64)
    owner_distance = np.full(len(frame_descriptors), _FAR, np.int64)
    for i in range(len(descriptors)):
        best, second, index = _FAR, _FAR, -1
        for k in range(len(frame_descriptors)):
            d = hamming(descriptors[i], frame_descriptors[k])
            if d < best:
                second, best, index = best, d, k
            elif d < second:
                second = d
        if best > limit or best > ratio * second or best >= owner_distance[index]:
            continue
        if owner[index] >= 0:
            match[owner[index]] = -1
        owner[index], owner_distance[index] = i, best
        match[i] = index
    keep_common_rotation(match, angles, frame_angles)
    return match


def match_by_descriptor(
    descriptors: NDArray[np.uint64],
    angles: NDArray[np.float32],
    frame: Features,
    *,
    limit: int,
    ratio: float,
) -> IntArray:
    """Match descriptors to all keypoints of a frame: nearest, by ratio test, at a common rotation.

    Args:
        descriptors: (M, 4) uint64.
        angles: (M,) float32 degrees.
        frame: The keypoints.
        limit: Largest Hamming distance.
        ratio: Largest ratio between the best and the second distance.

    Returns:
        (M,) int64 keypoint of every descriptor, -1 for none.
    """
    matched: IntArray = _brute_force(descriptors, angles, frame.descriptor, frame.angle, limit, ratio)
    return matched
