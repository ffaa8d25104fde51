"""FAST corners, their even selection and their orientation, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

# The circle of radius 3 that FAST compares with its centre, in order around it (dx, dy).
_CIRCLE_X = np.array([0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1], np.int64)
_CIRCLE_Y = np.array([3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1, 0, 1, 2, 3], np.int64)
PATCH_RADIUS = 15


def _patch_widths() -> NDArray[np.int64]:
    """Half width of every row of the orientation patch, made symmetric in x and y as ORB's is."""
    radius = PATCH_RADIUS
    widths = np.zeros(radius + 1, np.int64)
    last = int(np.floor(radius * np.sqrt(2.0) / 2 + 1))
    first = int(np.ceil(radius * np.sqrt(2.0) / 2))
    for v in range(last + 1):
        widths[v] = round(np.sqrt(radius * radius - v * v))
    upper = 0
    for v in range(radius, first - 1, -1):
        while widths[upper] == widths[upper + 1]:
            upper += 1
        widths[v] = upper
        upper += 1
    return widths


_PATCH_WIDTHS = _patch_widths()


def _runs_of_nine() -> NDArray[np.bool_]:
    """For every 16-bit mask of the circle, whether 9 set bits lie in a row."""
    masks = np.arange(1 << 16, dtype=np.uint32)
    doubled = masks | (masks << 16)
    runs = doubled.copy()
    for shift in range(1, 9):
        runs &= doubled >> np.uint32(shift)
    return (runs & 0xFFFF) != 0


_RUN_OF_NINE = _runs_of_nine()


@numba.njit(cache=True, nogil=True)
def _arc_score(image: np.ndarray, y: int, x: int, threshold: int, d: np.ndarray) -> int:
    """Return the largest contrast that 9 neighbours in a row have with the centre, 0 if not above ``threshold``.

    ``d`` is scratch memory, (24,) int64.
    """
    centre = np.int64(image[y, x])
    bright, dark = np.int64(0), np.int64(0)
    for i in range(16):
        d[i] = np.int64(image[y + _CIRCLE_Y[i], x + _CIRCLE_X[i]]) - centre
        bright |= np.int64(d[i] > threshold) << i
        dark |= np.int64(d[i] < -threshold) << i
    if _RUN_OF_NINE[bright]:
        sign = 1
    elif _RUN_OF_NINE[dark]:
        sign = -1
    else:
        return 0
    for i in range(16):
        d[i] *= sign
    for i in range(8):
        d[16 + i] = d[i]
    best = np.int64(0)
    for i in range(0, 16, 2):
        # The arcs that start at i and at i + 1 share eight pixels.
        shared = d[i + 1]
        for j in range(i + 2, i + 9):
            shared = min(shared, d[j])
        best = max(best, min(shared, d[i]), min(shared, d[i + 9] if i + 9 < 24 else d[i - 7]))
    return int(best)


@numba.njit(cache=True, nogil=True)
def fast_scores(image: np.ndarray, threshold: int, border: int, scores: np.ndarray) -> None:
    """Fill ``scores`` with FAST-9/16 contrasts above ``threshold``, 0 elsewhere.

    Args:
        image: (H, W) uint8.
        threshold: Smallest contrast, exclusive.
        border: Pixels at the border without corners.
        scores: (H, W) uint8, overwritten.
    """
    height, width = image.shape
    scores[:] = 0
    candidate = np.zeros(width, np.uint8)
    scratch = np.empty(24, np.int64)
    t = np.int16(threshold)
    for y in range(border, height - border):
        up, row, down = image[y - 3], image[y], image[y + 3]
        # 9 of 16 in a row hold one of each pair of opposites. Without branches, so that it compiles to vectors.
        for x in range(border, width - border):
            n, s = np.int16(up[x]), np.int16(down[x])
            e, w = np.int16(row[x + 3]), np.int16(row[x - 3])
            c = np.int16(row[x])
            bright = np.int16(min(max(n, s), max(e, w)) - c) > t
            dark = np.int16(c - max(min(n, s), min(e, w))) > t
            candidate[x] = bright | dark
        for x in range(border, width - border):
            if candidate[x]:
                scores[y, x] = _arc_score(image, y, x, threshold, scratch)


@numba.njit(cache=True, nogil=True)
def corners(
    scores: np.ndarray, threshold: int, cell: int, border: int, out_xy: np.ndarray, out_score: np.ndarray
) -> int:
    """Collect local maxima of the FAST scores; cells with a corner above ``threshold`` keep only such corners.

    Args:
        scores: (H, W) uint8.
        threshold: The higher of the two FAST thresholds.
        cell: Side of the cells, pixels.
        border: Pixels at the border without corners.
        out_xy: (C, 2) int32, filled.
        out_score: (C,) int32, filled.

    Returns:
        Number of corners.
    """
    height, width = scores.shape
    count = 0
    for y0 in range(border, height - border, cell):
        y1 = min(y0 + cell, height - border)
        for x0 in range(border, width - border, cell):
            x1 = min(x0 + cell, width - border)
            first, strong = count, 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    v = scores[y, x]
                    if v == 0 or (strong > 0 and v <= threshold) or count >= len(out_score):
                        continue
                    if (
                        v < scores[y, x - 1]
                        or v <= scores[y, x + 1]
                        or v < scores[y - 1, x - 1]
                        or v < scores[y - 1, x]
                        or v < scores[y - 1, x + 1]
                        or v <= scores[y + 1, x - 1]
                        or v <= scores[y + 1, x]
                        or v <= scores[y + 1, x + 1]
                    ):
                        continue
                    if v > threshold and strong == 0:
                        count = first
                    strong += v > threshold
                    out_xy[count, 0], out_xy[count, 1], out_score[count] = x, y, v
                    count += 1
    return count


@numba.njit(cache=True, nogil=True)
def _best_of_cells(
    xy: np.ndarray, score: np.ndarray, count: int, width: int, height: int, side: float, best: np.ndarray
) -> int:
    """Mark the strongest corner of every cell of ``side`` pixels in ``best``; return the number of occupied cells."""
    columns = int(width / side) + 1
    best[: columns * (int(height / side) + 1)] = -1
    occupied = 0
    for i in range(count):
        c = int(xy[i, 1] / side) * columns + int(xy[i, 0] / side)
        if best[c] < 0:
            occupied += 1
            best[c] = i
        elif score[i] > score[best[c]]:
            best[c] = i
    return occupied


@numba.njit(cache=True, nogil=True)
def select_evenly(xy: np.ndarray, score: np.ndarray, count: int, width: int, height: int, wanted: int) -> np.ndarray:
    """Choose about ``wanted`` corners spread over the image: the strongest of each occupied cell.

    The side of the cells is searched so that just enough of them are occupied, so bare regions leave their share to
    the textured ones, as ORB-SLAM2's quadtree does.

    Args:
        xy: (C, 2) int32 pixels.
        score: (C,) int32.
        count: Number of valid rows.
        width: Image width, pixels.
        height: Image height, pixels.
        wanted: Number of corners.

    Returns:
        (S,) int64 rows of ``xy``, S <= ``wanted``.
    """
    if count <= wanted:
        return np.arange(count)
    low, high = 2.0, float(max(width, height)) + 1.0
    best = np.empty((int(width / low) + 2) * (int(height / low) + 2), np.int64)
    for _ in range(12):
        side = 0.5 * (low + high)
        if _best_of_cells(xy, score, count, width, height, side, best) > wanted:
            low = side
        else:
            high = side
    _best_of_cells(xy, score, count, width, height, high, best)
    cells = (int(width / high) + 1) * (int(height / high) + 1)
    chosen = best[:cells]
    return chosen[chosen >= 0].copy()


@numba.njit(cache=True, nogil=True)
def orientations(image: np.ndarray, xy: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the direction of the intensity centroid of a circular patch, (S,) float32 degrees in [0, 360)."""
    angles = np.empty(len(rows), np.float32)
    for k in range(len(rows)):
        x, y = xy[rows[k], 0], xy[rows[k], 1]
        m10, m01 = np.int64(0), np.int64(0)
        for u in range(-PATCH_RADIUS, PATCH_RADIUS + 1):
            m10 += u * np.int64(image[y, x + u])
        for v in range(1, PATCH_RADIUS + 1):
            difference = np.int64(0)
            for u in range(-_PATCH_WIDTHS[v], _PATCH_WIDTHS[v] + 1):
                below, above = np.int64(image[y + v, x + u]), np.int64(image[y - v, x + u])
                difference += below - above
                m10 += u * (below + above)
            m01 += v * difference
        angle = np.degrees(np.arctan2(np.float64(m01), np.float64(m10)))
        angles[k] = angle + 360.0 if angle < 0 else angle
    return angles


@numba.njit(cache=True, nogil=True)
def cell_order(uv: np.ndarray, columns: int, rows: int, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Sort keypoints by grid cell, row by row, so that a cell is a range of keypoints.

    Args:
        uv: (N, 2) float32 pixels.
        columns: Cells per row.
        rows: Rows of cells.
        cell: Side of a cell, pixels.

    Returns:
        (N,) int64 order and (rows * columns + 1,) int32 first keypoint of every cell.
    """
    n = len(uv)
    cell_of = np.empty(n, np.int64)
    start = np.zeros(rows * columns + 1, np.int32)
    for i in range(n):
        c = min(max(int(uv[i, 0] / cell), 0), columns - 1)
        r = min(max(int(uv[i, 1] / cell), 0), rows - 1)
        cell_of[i] = r * columns + c
        start[cell_of[i] + 1] += 1
    for c in range(rows * columns):
        start[c + 1] += start[c]
    fill = start[:-1].copy()
    order = np.empty(n, np.int64)
    for i in range(n):
        order[fill[cell_of[i]]] = i
        fill[cell_of[i]] += 1
    return order, start
