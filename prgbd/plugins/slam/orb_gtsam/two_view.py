"""Geometry of two views: triangulation, and the first map of a monocular camera."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.lie import inverse

FloatArray = NDArray[np.float64]


def triangulate_pairs(c1Tw: FloatArray, c2Tw: FloatArray, rays1: FloatArray, rays2: FloatArray) -> FloatArray:
    """Triangulate points from two views, each with the least reprojection error in the normalised images.

    Every pair of rays is first moved onto each other's epipolar lines (Lindstrom, "Triangulation made easy",
    CVPR 2010, two iterations), then intersected.

    Args:
        c1Tw: (4, 4) first pose, world to camera.
        c2Tw: (4, 4) second pose.
        rays1: (N, 2) normalised image coordinates ``(x/z, y/z)`` in the first view.
        rays2: (N, 2) in the second.

    Returns:
        (N, 3) points in the world. A row is NaN where the rays are parallel, and lies behind a camera where they meet
        there: both fail a check of depth and reprojection.
    """
    c2Tc1 = np.asarray(c2Tw, np.float64) @ inverse(np.asarray(c1Tw, np.float64))
    points = np.empty((len(rays1), 3))
    _triangulate(c2Tc1, np.ascontiguousarray(rays1, np.float64), np.ascontiguousarray(rays2, np.float64), points)
    wTc1 = inverse(np.asarray(c1Tw, np.float64))
    return points @ wTc1[:3, :3].T + wTc1[:3, 3]


@numba.njit(cache=True, nogil=True)
def _triangulate(c2Tc1: FloatArray, rays1: FloatArray, rays2: FloatArray, points: FloatArray) -> None:
    """Fill ``points`` in coordinates of camera 1."""
    E = np.empty((3, 3))
    t0, t1, t2 = c2Tc1[0, 3], c2Tc1[1, 3], c2Tc1[2, 3]
    for j in range(3):
        r0, r1, r2 = c2Tc1[0, j], c2Tc1[1, j], c2Tc1[2, j]
        E[0, j] = t1 * r2 - t2 * r1
        E[1, j] = t2 * r0 - t0 * r2
        E[2, j] = t0 * r1 - t1 * r0
    for k in range(len(rays1)):
        x1, y1, x2, y2 = _onto_epipolar_lines(E, rays1[k, 0], rays1[k, 1], rays2[k, 0], rays2[k, 1])
        # depth * (x1, y1, 1) rotated, plus t, is parallel to (x2, y2, 1).
        a0 = c2Tc1[0, 0] * x1 + c2Tc1[0, 1] * y1 + c2Tc1[0, 2]
        a1 = c2Tc1[1, 0] * x1 + c2Tc1[1, 1] * y1 + c2Tc1[1, 2]
        a2 = c2Tc1[2, 0] * x1 + c2Tc1[2, 1] * y1 + c2Tc1[2, 2]
        c0, c1, c2 = y2 * a2 - a1, a0 - x2 * a2, x2 * a1 - y2 * a0
        d0, d1, d2 = y2 * t2 - t1, t0 - x2 * t2, x2 * t1 - y2 * t0
        square = c0 * c0 + c1 * c1 + c2 * c2
        depth = -(c0 * d0 + c1 * d1 + c2 * d2) / square if square > 1e-20 else math.nan
        points[k, 0], points[k, 1], points[k, 2] = depth * x1, depth * y1, depth


@numba.njit(cache=True, nogil=True)
def _onto_epipolar_lines(
    E: FloatArray, x1: float, y1: float, x2: float, y2: float
) -> tuple[float, float, float, float]:
    """Return the nearest rays that fulfil ``r2' E r1 = 0``."""
    # n1 = S E r1 lies across the line in image 2, n2 = S E' r2 across the line in image 1.
    n1x = E[0, 0] * x1 + E[0, 1] * y1 + E[0, 2]
    n1y = E[1, 0] * x1 + E[1, 1] * y1 + E[1, 2]
    n2x = E[0, 0] * x2 + E[1, 0] * y2 + E[2, 0]
    n2y = E[0, 1] * x2 + E[1, 1] * y2 + E[2, 1]
    c = x2 * n1x + y2 * n1y + E[2, 0] * x1 + E[2, 1] * y1 + E[2, 2]
    a = n2x * (E[0, 0] * n1x + E[1, 0] * n1y) + n2y * (E[0, 1] * n1x + E[1, 1] * n1y)
    b = 0.5 * (n1x * n1x + n1y * n1y + n2x * n2x + n2y * n2y)
    d = b * b - a * c
    if not (d >= 0.0 and b > 0.0):
        return x1, y1, x2, y2
    step = c / (b + math.sqrt(d))
    dx1, dy1, dx2, dy2 = step * n2x, step * n2y, step * n1x, step * n1y
    m1x, m1y = n1x - (E[0, 0] * dx1 + E[0, 1] * dy1), n1y - (E[1, 0] * dx1 + E[1, 1] * dy1)
    m2x, m2y = n2x - (E[0, 0] * dx2 + E[1, 0] * dy2), n2y - (E[0, 1] * dx2 + E[1, 1] * dy2)
    square1, square2 = m1x * m1x + m1y * m1y, m2x * m2x + m2y * m2y
    if square1 == 0.0 or square2 == 0.0:
        return x1, y1, x2, y2
    along1 = (dx2 * m1x + dy2 * m1y) / square1
    along2 = (dx1 * m2x + dy1 * m2y) / square2
    return x1 - along2 * m2x, y1 - along2 * m2y, x2 - along1 * m1x, y2 - along1 * m1y
