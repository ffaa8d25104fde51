"""Matching of ORB descriptors along epipolar lines."""

from __future__ import annotations

import numpy as np

from prgbd.plugins.slam.orb_gtsam.features.matching import hamming, keep_common_rotation
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

_FAR = 1 << 20
# 95 % limit of one degree of freedom, for the distance from the line; and the square of the pixels that a partner must
# keep from the epipole at the finest level (ORB-SLAM2: ORBmatcher::SearchForTriangulation).
_CHI2_LINE = 3.84
_EPIPOLE_RADIUS2 = 100.0


@kernel()
def search_segments(
    rows: np.ndarray, uv: np.ndarray, c2Tc1: np.ndarray, camera: np.ndarray, nearest: float
) -> np.ndarray:
    """Return where keypoints may lie in another image, (M, 4): their pixels at infinity and at ``nearest`` depth.

    Args:
        rows: (M,) int64 keypoints.
        uv: (N, 2) float32 pixels.
        c2Tc1: (4, 4) pose of the first camera seen from the other.
        camera: ``fx, fy, cx, cy`` and more.
        nearest: Least depth of a point, in the unit of the map.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    ends = np.empty((len(rows), 4))
    for i in range(len(rows)):
        x, y = (uv[rows[i], 0] - cx) / fx, (uv[rows[i], 1] - cy) / fy
        for end in range(2):
            depth, shift = (1.0, 0.0) if end == 0 else (nearest, 1.0)
            p0 = (c2Tc1[0, 0] * x + c2Tc1[0, 1] * y + c2Tc1[0, 2]) * depth + shift * c2Tc1[0, 3]
            p1 = (c2Tc1[1, 0] * x + c2Tc1[1, 1] * y + c2Tc1[1, 2]) * depth + shift * c2Tc1[1, 3]
            p2 = (c2Tc1[2, 0] * x + c2Tc1[2, 1] * y + c2Tc1[2, 2]) * depth + shift * c2Tc1[2, 3]
            if p2 > 1e-3 * depth:
                ends[i, 2 * end], ends[i, 2 * end + 1] = fx * p0 / p2 + cx, fy * p1 / p2 + cy
            else:
                # What lies beside or behind the other camera leaves that end of the line open.
                ends[i, 2 * end] = 1e9 if p0 >= 0 else -1e9
                ends[i, 2 * end + 1] = 1e9 if p1 >= 0 else -1e9
    return ends


@kernel()
def _partners(
    uv: np.ndarray,
    octave: np.ndarray,
    cell_start: np.ndarray,
    taken: np.ndarray,
    epipole: np.ndarray,
    scales: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the keypoints that may be partners, in the order of cells.

    Returns:
        (n, 3) float32 pixel and largest square distance from a line; (n,) int64 keypoint; first of every cell.
    """
    place, index = np.empty((len(uv), 3), np.float32), np.empty(len(uv), np.int64)
    start = np.zeros(len(cell_start), np.int64)
    n = 0
    for cell in range(len(cell_start) - 1):
        for j in range(cell_start[cell], cell_start[cell + 1]):
            scale = scales[octave[j]]
            ex, ey = epipole[0] - uv[j, 0], epipole[1] - uv[j, 1]
            if taken[j] or ex * ex + ey * ey < _EPIPOLE_RADIUS2 * scale:
                continue
            place[n, 0], place[n, 1], place[n, 2] = uv[j, 0], uv[j, 1], _CHI2_LINE * scale * scale
            index[n] = j
            n += 1
        start[cell + 1] = n
    return place[:n], index[:n], start


@kernel()
def _best_on_line(
    line: np.ndarray,
    ends: np.ndarray,
    descriptor: np.ndarray,
    place: np.ndarray,
    index: np.ndarray,
    start: np.ndarray,
    octave: np.ndarray,
    descriptors: np.ndarray,
    columns: int,
    cell: float,
    band: float,
    limit: int,
) -> tuple[int, int, int]:
    """Return the nearest descriptor along a line ``(a, b, c)`` of unit normal, its distance, and the second distance.

    Row by row, only the cells that the line and its band pass through between the ends are visited.
    """
    a, b, c = line[0], line[1], line[2]
    if a < 0:
        a, b, c = -a, -b, -c
    rows = (len(start) - 1) // columns
    best, chosen, second = limit + 1, -1, _FAR
    u0, u1 = max(min(ends[0], ends[2]) - band, 0.0), min(max(ends[0], ends[2]) + band, columns * cell - 1.0)
    v0, v1 = max(min(ends[1], ends[3]) - band, 0.0), min(max(ends[1], ends[3]) + band, rows * cell - 1.0)
    if not (u0 <= u1 and v0 <= v1):
        return chosen, best, second
    for row in range(int(v0 / cell), int(v1 / cell) + 1):
        at0, at1 = -b * row * cell, -b * (row + 1) * cell
        low, high = min(at0, at1) - c - band, max(at0, at1) - c + band
        if low > a * u1 or high < a * u0:
            continue
        # Here low <= a u <= high; a horizontal line leaves u open.
        left = max(low / a, u0) if a > 1e-9 else u0
        right = min(high / a, u1) if a > 1e-9 else u1
        here = row * columns
        for m in range(start[here + int(left / cell)], start[here + int(right / cell) + 1]):
            distance = a * place[m, 0] + b * place[m, 1] + c
            if distance * distance >= place[m, 2]:
                continue
            j = index[m]
            d = hamming(descriptor, descriptors[j])
            same_level = chosen >= 0 and octave[chosen] == octave[j]
            if d < best:
                second = best if same_level else _FAR
                best, chosen = d, j
            elif d < second and same_level:
                second = d
    return chosen, best, second


@kernel()
def match_along_epipolar_lines(
    rows: np.ndarray,
    uv1: np.ndarray,
    descriptors1: np.ndarray,
    angles1: np.ndarray,
    uv2: np.ndarray,
    octave2: np.ndarray,
    descriptors2: np.ndarray,
    angles2: np.ndarray,
    cell_start: np.ndarray,
    taken: np.ndarray,
    columns: int,
    cell: float,
    F: np.ndarray,
    ends: np.ndarray,
    epipole: np.ndarray,
    scales: np.ndarray,
    limit: int,
    ratio: float,
) -> np.ndarray:
    """Match keypoints of one keyframe to those of another that lie on their epipolar lines.

    Args:
        rows: (M,) int64 keypoints of the first keyframe to match.
        uv1: (N1, 2) float32 pixels.
        descriptors1: (N1, 4) uint64.
        angles1: (N1,) float32 degrees.
        uv2: (N2, 2) float32 pixels.
        octave2: (N2,) int32.
        descriptors2: (N2, 4) uint64.
        angles2: (N2,) float32 degrees.
        cell_start: First keypoint of every grid cell of the second keyframe.
        taken: (N2,) bool keypoints that may not match.
        columns: Grid cells per row.
        cell: Side of a cell, pixels.
        F: (3, 3) fundamental matrix, ``x2' F x1 = 0``.
        ends: (M, 4) the pixels ``u, v, u, v`` in the second image between which a partner may lie.
        epipole: (2,) pixel of the first camera's centre in the second image; nearby keypoints are skipped.
        scales: (levels,) scale of every pyramid level.
        limit: Largest Hamming distance.
        ratio: Largest ratio between the best distance and the second one at the same level elsewhere on the line.

    Returns:
        (M,) int64 keypoint of the second keyframe, -1 for none.
    """
    place, index, start = _partners(uv2, octave2, cell_start, taken, epipole, scales)
    band = np.sqrt(_CHI2_LINE) * scales[-1] + 1.0
    match = np.full(len(rows), -1, np.int64)
    owner = np.full(len(uv2), -1, np.int64)
    owner_distance = np.full(len(uv2), _FAR, np.int64)
    line = np.empty(3)
    for i in range(len(rows)):
        x, y = np.float64(uv1[rows[i], 0]), np.float64(uv1[rows[i], 1])
        for r in range(3):
            line[r] = F[r, 0] * x + F[r, 1] * y + F[r, 2]
        norm = np.sqrt(line[0] * line[0] + line[1] * line[1])
        if norm < 1e-12:
            continue
        line /= norm
        chosen, best, second = _best_on_line(
            line, ends[i], descriptors1[rows[i]], place, index, start, octave2, descriptors2, columns, cell, band, limit
        )
        if chosen < 0 or best > ratio * second or best >= owner_distance[chosen]:
            continue
        if owner[chosen] >= 0:
            match[owner[chosen]] = -1
        owner[chosen], owner_distance[chosen] = i, best
        match[i] = chosen
    keep_common_rotation(match, angles1[rows], angles2)
    return match
