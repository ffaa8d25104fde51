"""FAST corners, their even selection and their orientation, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.kernels import kernel

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


@kernel(inline="always")
def _highest_arc(
    p0: np.int16, p1: np.int16, p2: np.int16, p3: np.int16, p4: np.int16, p5: np.int16, p6: np.int16, p7: np.int16,
    p8: np.int16, p9: np.int16, p10: np.int16, p11: np.int16, p12: np.int16, p13: np.int16, p14: np.int16,
    p15: np.int16,
) -> np.int16:  # fmt: skip
    """Return the highest value that 9 neighbours on the circle of 16 all reach.

    The arcs that begin at an even place and at the next share eight values, and those eight are two fours.
    """
    a1, a3, a5, a7 = min(p1, p2), min(p3, p4), min(p5, p6), min(p7, p8)
    a9, a11, a13, a15 = min(p9, p10), min(p11, p12), min(p13, p14), min(p15, p0)
    b1, b3, b5, b7 = min(a1, a3), min(a3, a5), min(a5, a7), min(a7, a9)
    b9, b11, b13, b15 = min(a9, a11), min(a11, a13), min(a13, a15), min(a15, a1)
    c1, c3 = min(min(b1, b5), max(p0, p9)), min(min(b3, b7), max(p2, p11))
    c5, c7 = min(min(b5, b9), max(p4, p13)), min(min(b7, b11), max(p6, p15))
    c9, c11 = min(min(b9, b13), max(p8, p1)), min(min(b11, b15), max(p10, p3))
    c13, c15 = min(min(b13, b1), max(p12, p5)), min(min(b15, b3), max(p14, p7))
    return max(max(max(c1, c3), max(c5, c7)), max(max(c9, c11), max(c13, c15)))


@kernel()
def fast_scores(image: np.ndarray, threshold: int, border: int, scores: np.ndarray) -> None:
    """Fill ``scores`` with FAST-9/16 contrasts above ``threshold``, 0 elsewhere.

    Every pixel is computed without a branch and with unsigned indices, so that the loop compiles to vectors: ten times
    faster than testing candidates one by one.

    Args:
        image: (H, W) uint8.
        threshold: Smallest contrast, exclusive.
        border: Pixels at the border without corners, at least 3.
        scores: (H, W) uint8, overwritten: the largest t at which the pixel is a corner, plus 1.
    """
    height, width = image.shape
    scores[:] = 0
    t = np.int16(threshold)
    for y in range(border, height - border):
        r0, r1, r2, r3 = image[y - 3], image[y - 2], image[y - 1], image[y]
        r4, r5, r6, out = image[y + 1], image[y + 2], image[y + 3], scores[y]
        for x in range(border, width - border):
            a3, a2, a1, o = np.uintp(x - 3), np.uintp(x - 2), np.uintp(x - 1), np.uintp(x)
            b1, b2, b3 = np.uintp(x + 1), np.uintp(x + 2), np.uintp(x + 3)
            centre = np.int16(r3[o])
            p0, p1, p2, p3 = np.int16(r6[o]), np.int16(r6[b1]), np.int16(r5[b2]), np.int16(r4[b3])
            p4, p5, p6, p7 = np.int16(r3[b3]), np.int16(r2[b3]), np.int16(r1[b2]), np.int16(r0[b1])
            p8, p9, p10, p11 = np.int16(r0[o]), np.int16(r0[a1]), np.int16(r1[a2]), np.int16(r2[a3])
            p12, p13, p14, p15 = np.int16(r3[a3]), np.int16(r4[a3]), np.int16(r5[a2]), np.int16(r6[a1])
            high = _highest_arc(p0, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11, p12, p13, p14, p15)
            q0, q1, q2, q3 = np.int16(-p0), np.int16(-p1), np.int16(-p2), np.int16(-p3)
            q4, q5, q6, q7 = np.int16(-p4), np.int16(-p5), np.int16(-p6), np.int16(-p7)
            q8, q9, q10, q11 = np.int16(-p8), np.int16(-p9), np.int16(-p10), np.int16(-p11)
            q12, q13, q14, q15 = np.int16(-p12), np.int16(-p13), np.int16(-p14), np.int16(-p15)
            low = _highest_arc(q0, q1, q2, q3, q4, q5, q6, q7, q8, q9, q10, q11, q12, q13, q14, q15)
            contrast = max(np.int16(high - centre), np.int16(low + centre))
            out[o] = np.uint8(contrast) if contrast > t else np.uint8(0)


@kernel()
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


@kernel()
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


@kernel()
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


@kernel()
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


@kernel()
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
