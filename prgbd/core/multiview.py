"""What poses, pixels and points say of each other when a scene is seen from several places; no depth is needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import Keyframes, MapPoints, Observations, PinholeCamera

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Worse conditioned information means parallel rays: the inverse would be made of rounding errors.
_WORST_CONDITION = 1e12


@dataclass(frozen=True)
class TriangulatedPoints:
    """Points where the rays of their observations meet best in the sense of least squares, as columns.

    Attributes:
        xyz: (P, 3) world coordinates; NaN where rays are missing or parallel.
        covariance: (P, 3, 3) of the points, NaN likewise.
        parallax: (P,) radians, under what angle the rays of a point meet: root mean square over its rays of the angle
            to the direction in which the point is known worst; 0 without rays.
        views: (P,) number of rays.
    """

    xyz: Floats
    covariance: Floats
    parallax: Floats
    views: Ints

    def depth(self, wTc: Floats, point: Ints) -> tuple[Floats, Floats]:
        """Return the depth of points in cameras.

        Args:
            wTc: (M, 4, 4) poses.
            point: (M,) row of the point in front of each camera.

        Returns:
            (M,) depth and (M,) its standard deviation; NaN where the point could not be triangulated.
        """
        axis = wTc[:, :3, 2]
        depth = np.einsum("ni,ni->n", axis, self.xyz[point] - wTc[:, :3, 3])
        return depth, np.sqrt(np.einsum("ni,nij,nj->n", axis, self.covariance[point], axis))


def triangulate(wTc: Floats, rays: Floats, point: Ints, count: int, sigma: Floats | None = None) -> TriangulatedPoints:
    """Place points where the rays of their observations meet best; measured depth has no say.

    Args:
        wTc: (M, 4, 4) pose of the camera of every observation.
        rays: (M, 2) normalised image coordinates, without distortion.
        point: (M,) row of the observed point.
        count: Number of points.
        sigma: (M,) by how much a point may lie off its ray, standard deviation in metres (or SLAM's unit); None weighs
            all rays by 1.

    Returns:
        The ``count`` points.
    """
    direction = np.einsum("nij,nj->ni", wTc[:, :3, :3], np.c_[rays, np.ones(len(rays))])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    views = np.bincount(point, minlength=count)
    spread = _summed(across, point, count)
    parallax = np.arcsin(np.sqrt(np.clip(np.linalg.eigvalsh(spread)[:, 0] / np.maximum(views, 1), 0, 1)))
    if sigma is not None:
        across /= sigma[:, None, None] ** 2
        spread = _summed(across, point, count)
    pull = _summed(np.einsum("nij,nj->ni", across, wTc[:, :3, 3]), point, count)
    covariance = np.full_like(spread, np.nan)
    well_posed = np.linalg.cond(spread) < _WORST_CONDITION
    covariance[well_posed] = np.linalg.inv(spread[well_posed])
    return TriangulatedPoints(np.einsum("nij,nj->ni", covariance, pull), covariance, parallax, views)


def extreme_parallax(keyframes: Keyframes, points: MapPoints, seen: Observations) -> Floats:
    """Return under what angle the first and the last keyframe that observe a point see it, (P,) degrees.

    It says how well SLAM knows a point's depth; 0 where fewer than two keyframes observe it.
    """
    first = np.full(len(points), len(keyframes))
    last = np.full(len(points), -1)
    np.minimum.at(first, seen.point, seen.keyframe)
    np.maximum.at(last, seen.point, seen.keyframe)
    angle = np.zeros(len(points))
    known = np.flatnonzero(last > first)
    rays = points.xyz[known] - keyframes.wTc[np.stack([first[known], last[known]]), :3, 3]
    sine = np.linalg.norm(np.cross(rays[0], rays[1]), axis=1)
    angle[known] = np.degrees(np.arctan2(sine, np.sum(rays[0] * rays[1], axis=1)))
    return angle


def points_in_camera(wTc: Floats, xyz: Floats) -> Floats:
    """Move world points (M, 3) into cameras ``wTc``, one pose (4, 4) for all or one per point (M, 4, 4)."""
    offset = xyz - wTc[..., :3, 3]
    return np.einsum("...ji,...j->...i", wTc[..., :3, :3], offset)


def reprojection_errors(camera: PinholeCamera, keyframes: Keyframes, points: MapPoints, seen: Observations) -> Floats:
    """Return the distance of every observation to its projected point, (M,) pixels; infinite behind the camera."""
    rays = points_in_camera(keyframes.wTc[seen.keyframe], points.xyz[seen.point])
    ahead = rays[:, 2] > 1e-9
    errors = np.full(len(seen), np.inf)
    errors[ahead] = np.linalg.norm(camera.project(rays[ahead]) - seen.uv[ahead], axis=1)
    return errors


def rows_by_group(group: Ints, fewest: int = 1) -> list[Ints]:
    """Return the rows of each group, ascending by group and row; groups of fewer than ``fewest`` rows are left out."""
    order = np.argsort(group, kind="stable")
    _, first = np.unique(group[order], return_index=True)
    return [rows for rows in np.split(order, first[1:]) if len(rows) >= max(fewest, 1)]


def _summed(values: Floats, row: Ints, count: int) -> Floats:
    """Sum of the values of each row, (count, ...)."""
    total = np.zeros((count, *values.shape[1:]))
    np.add.at(total, row, values)
    return total
