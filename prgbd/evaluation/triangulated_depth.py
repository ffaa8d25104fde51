"""Measured depth beside points triangulated from SLAM's poses and pixels alone: what can be said without labels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.core.multiview import points_in_camera, rows_by_group, triangulate
from prgbd.core.types import Observations, SlamResult

# A point counts that so many keyframes see under such a parallax: its depth is then good to a few per cent.
_FEWEST_VIEWS = 3
_LEAST_PARALLAX = np.radians(1.0)
# Fewer points do not tell the scale of a keyframe.
_FEWEST_POINTS = 10


def triangulated(result: SlamResult) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Find every map point again from SLAM's poses and the pixels of its keypoints alone, without any depth.

    Returns:
        (P, 3) points nearest to their rays, and (P,) which of them are seen from three keyframes with a parallax of a
        degree or more (root mean square over the rays); the others are NaN.
    """
    seen = result.observations
    rays = result.camera.backproject(seen.uv, np.ones(len(seen)))[:, :2]
    found = triangulate(result.keyframes.wTc[seen.keyframe], rays, seen.point, len(result.points))
    good = (found.views >= _FEWEST_VIEWS) & (found.parallax > _LEAST_PARALLAX)
    return np.where(good[:, None], found.xyz, np.nan), good


def disagreement(result: SlamResult, seen: Observations) -> tuple[float | None, float | None]:
    """Compare measured (or predicted) depth with triangulated depth at the keypoints of all keyframes.

    Triangulation takes nothing but poses and pixels, so that a map that simply follows the network's depth does not
    count as agreement.

    Args:
        result: SLAM's output.
        seen: Its observations with their measured depth, without outliers.

    Returns:
        The mean absolute difference of the logarithms after the median of each keyframe is taken out, and the standard
        deviation of those medians; None without points.
    """
    ratio, keyframe = _logarithms(result, seen)
    groups = [ratio[rows] for rows in rows_by_group(keyframe, _FEWEST_POINTS)]
    if not groups:
        return None, None
    medians = [float(np.median(group)) for group in groups]
    residuals = [np.abs(group - median) for group, median in zip(groups, medians, strict=True)]
    return float(np.mean(np.concatenate(residuals))), float(np.std(medians))


def triangulated_ratios(result: SlamResult, seen: Observations) -> NDArray[np.float64]:
    """Return measured over triangulated depth of all observations where both are known, (N,)."""
    return np.exp(_logarithms(result, seen)[0])


def triangulated_observations(result: SlamResult, seen: Observations) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the observations whose points are triangulated, (N,) rows of ``seen``, and their depth in the keyframe."""
    points, good = triangulated(result)
    rows = np.flatnonzero(good[seen.point])
    depth = points_in_camera(result.keyframes.wTc[seen.keyframe[rows]], points[seen.point[rows]])[:, 2]
    return rows[depth > 0], depth[depth > 0]


def _logarithms(result: SlamResult, seen: Observations) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the logarithms of measured over triangulated depth, (N,), and their keyframes, (N,)."""
    rows, depth = triangulated_observations(result, seen)
    known = seen.depth[rows] > 0
    rows, depth = rows[known], depth[known]
    return np.log(seen.depth[rows].astype(np.float64) / depth), np.asarray(seen.keyframe[rows], np.int64)
