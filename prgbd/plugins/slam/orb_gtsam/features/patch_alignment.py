"""Where exactly a keyframe sees what another keyframe sees around a keypoint: alignment of small patches."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.kernels import FAST, kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Half side of a patch, pixels of a pyramid level.
_HALF = 4
_SIDE = 2 * _HALF + 1
_ITERATIONS = 12
# Update at which the alignment has converged, the longest of one iteration, and the longest way from the keypoint,
# pixels of a level: a corner of FAST lies within a pixel of where the patch says.
_CONVERGED, _STEP, _FARTHEST = 0.02, 1.0, 2.0
# Grey levels below which a patch has no texture.
_FLAT = 2.0

# What became of an alignment: nothing could be said, as a patch leaves the image or has no texture in both directions;
# the patches agree; or they do not.
UNDECIDED, AGREES, DISAGREES = 0, 1, 2


@kernel(fastmath=FAST, forceinline=True)
def _at(pixels: np.ndarray, first: int, width: int, x: float, y: float) -> float:
    """Grey level between four pixels of a level."""
    i, j = int(x), int(y)
    a, b = x - i, y - j
    o = first + j * width + i
    top = pixels[o] * (1.0 - a) + pixels[o + 1] * a
    below = pixels[o + width] * (1.0 - a) + pixels[o + width + 1] * a
    return top * (1.0 - b) + below * b


@kernel(fastmath=FAST, forceinline=True)
def _template(pixels: np.ndarray, first: int, width: int, x: float, y: float, T: np.ndarray, D: np.ndarray) -> float:
    """Fill the patch around (x, y) without its mean, and its gradient without theirs; return its norm."""
    mean, mean_x, mean_y = 0.0, 0.0, 0.0
    for r in range(_SIDE):
        for c in range(_SIDE):
            px, py = x + c - _HALF, y + r - _HALF
            n = r * _SIDE + c
            T[n] = _at(pixels, first, width, px, py)
            D[n, 0] = 0.5 * (_at(pixels, first, width, px + 1, py) - _at(pixels, first, width, px - 1, py))
            D[n, 1] = 0.5 * (_at(pixels, first, width, px, py + 1) - _at(pixels, first, width, px, py - 1))
            mean, mean_x, mean_y = mean + T[n], mean_x + D[n, 0], mean_y + D[n, 1]
    square = 0.0
    for n in range(_SIDE * _SIDE):
        T[n] -= mean / (_SIDE * _SIDE)
        D[n, 0] -= mean_x / (_SIDE * _SIDE)
        D[n, 1] -= mean_y / (_SIDE * _SIDE)
        square += T[n] * T[n]
    return math.sqrt(square)


@kernel(fastmath=FAST, forceinline=True)
def _warped(pixels: np.ndarray, first: int, width: int, x: float, y: float, A: np.ndarray, W: np.ndarray) -> float:
    """Fill the warped patch around (x, y) without its mean; return its norm."""
    mean = 0.0
    for r in range(_SIDE):
        for c in range(_SIDE):
            u, v = c - _HALF, r - _HALF
            n = r * _SIDE + c
            W[n] = _at(pixels, first, width, x + A[0, 0] * u + A[0, 1] * v, y + A[1, 0] * u + A[1, 1] * v)
            mean += W[n]
    square = 0.0
    for n in range(_SIDE * _SIDE):
        W[n] -= mean / (_SIDE * _SIDE)
        square += W[n] * W[n]
    return math.sqrt(square)


@kernel(forceinline=True)
def _inside(x: float, y: float, width: int, height: int, reach: float) -> bool:
    return x >= reach and y >= reach and x < width - 1 - reach and y < height - 1 - reach


@kernel(fastmath=FAST)
def align_patches(
    pixels: np.ndarray,
    offset: IntArray,
    width: IntArray,
    height: IntArray,
    reference_slot: IntArray,
    reference_octave: IntArray,
    reference_xy: FloatArray,
    slot: IntArray,
    octave: IntArray,
    warp: FloatArray,
    least: float,
    xy: FloatArray,
    outcome: NDArray[np.int8],
) -> None:
    """Move keypoints to where the patch around their reference keypoint fits best (inverse compositional, two shifts).

    Brightness and contrast do not matter. Baker and Matthews, "Lucas-Kanade 20 Years On" (2004), section 3.2, with the
    patch warped once by what the map says of scale and rotation, as in SVO.

    Args:
        pixels: (N, S) uint8, as ``RecentImages`` keeps them, like the next three.
        offset: (L,) where a level begins.
        width: (L,) its columns.
        height: (L,) its rows.
        reference_slot: (M,) pyramid of the reference.
        reference_octave: (M,) its level.
        reference_xy: (M, 2) reference keypoint, pixels of that level.
        slot: (M,) pyramid of the keypoint.
        octave: (M,) its level.
        warp: (M, 2, 2) from offsets in the reference's level to offsets in the keypoint's.
        least: Normalised cross-correlation from which patches agree.
        xy: (M, 2) the keypoints, pixels of their level; those that agree are moved.
        outcome: Receives (M,) ``UNDECIDED``, ``AGREES`` or ``DISAGREES``.
    """
    T, D, W = np.empty(_SIDE * _SIDE), np.empty((_SIDE * _SIDE, 2)), np.empty(_SIDE * _SIDE)
    for m in range(len(xy)):
        outcome[m] = UNDECIDED
        a, b, A = reference_octave[m], octave[m], warp[m]
        x, y = reference_xy[m, 0], reference_xy[m, 1]
        if not _inside(x, y, width[a], height[a], _HALF + 1.0):
            continue
        norm = _template(pixels[reference_slot[m]], offset[a], width[a], x, y, T, D)
        h00, h01, h11 = 0.0, 0.0, 0.0
        for n in range(_SIDE * _SIDE):
            h00 += D[n, 0] * D[n, 0]
            h01 += D[n, 0] * D[n, 1]
            h11 += D[n, 1] * D[n, 1]
        det = h00 * h11 - h01 * h01
        if norm < _FLAT * _SIDE or not det > 1e-3 * h00 * h11:
            continue
        reach = _HALF * (max(abs(A[0, 0]) + abs(A[0, 1]), abs(A[1, 0]) + abs(A[1, 1])))
        x, y = xy[m, 0], xy[m, 1]
        correlation, moved, within = 0.0, 1.0, True
        for _ in range(_ITERATIONS):
            within = _inside(x, y, width[b], height[b], reach)
            if not within:
                break
            other = _warped(pixels[slot[m]], offset[b], width[b], x, y, A, W)
            product = 0.0
            for n in range(_SIDE * _SIDE):
                product += W[n] * T[n]
            correlation = product / max(other * norm, 1e-9)
            if moved < _CONVERGED or correlation <= 0.0:
                break
            gain = product / (norm * norm)
            b0, b1 = 0.0, 0.0
            for n in range(_SIDE * _SIDE):
                r = W[n] / gain - T[n]
                b0 += D[n, 0] * r
                b1 += D[n, 1] * r
            s, t = (h11 * b0 - h01 * b1) / det, (h00 * b1 - h01 * b0) / det
            dx, dy = -(A[0, 0] * s + A[0, 1] * t), -(A[1, 0] * s + A[1, 1] * t)
            moved = math.hypot(dx, dy)
            if moved > _STEP:
                dx, dy = dx * _STEP / moved, dy * _STEP / moved
            x, y = x + dx, y + dy
        if not within:
            continue
        near = math.hypot(x - xy[m, 0], y - xy[m, 1]) <= _FARTHEST
        if correlation >= least and moved < 5.0 * _CONVERGED and near:
            outcome[m] = AGREES
            xy[m, 0], xy[m, 1] = x, y
        else:
            outcome[m] = DISAGREES
