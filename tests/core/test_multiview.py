"""Triangulation finds what was put in, parallax is the angle that it says, and errors are those of projection."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.core.multiview import (
    extreme_parallax,
    points_in_camera,
    reprojection_errors,
    rows_by_group,
    triangulate,
)
from prgbd.core.types import Keyframes, MapPoints, Observations, PinholeCamera


def observed(keyframe, point, uv=None):
    uv = np.zeros((len(point), 2)) if uv is None else uv
    return Observations(keyframe, point, uv.astype(np.float32), np.zeros(len(point), np.float32))


def along_x(*positions):
    wTc = np.tile(np.eye(4), (len(positions), 1, 1))
    wTc[:, 0, 3] = positions
    return wTc


def test_rays_meet_in_their_point_and_uncertainty_is_that_of_repetitions():
    rng = np.random.default_rng(1)
    wTc, truth, repetitions, sigma = along_x(0.0, 0.3, 0.6), np.array([0.4, -0.2, 5.0]), 2000, 1e-3
    local = points_in_camera(wTc, np.tile(truth, (3, 1)))
    rays = np.tile(local[:, :2] / local[:, 2:], (repetitions, 1))
    rays += sigma * rng.standard_normal(rays.shape)
    point, poses = np.repeat(np.arange(repetitions), 3), np.tile(wTc, (repetitions, 1, 1))
    across = np.tile(sigma * np.linalg.norm(local, axis=1), repetitions)
    found = triangulate(poses, rays, point, repetitions, across)
    np.testing.assert_allclose(np.median(found.xyz, axis=0), truth, atol=0.01)
    np.testing.assert_allclose(found.xyz.std(axis=0), np.sqrt(np.diag(found.covariance[0])), rtol=0.15)
    depth, spread = found.depth(poses, point)
    np.testing.assert_allclose(depth, found.xyz[point, 2])
    np.testing.assert_allclose(spread, np.sqrt(found.covariance[point, 2, 2]))


def test_a_single_ray_and_none_place_no_point():
    found = triangulate(along_x(0.0), np.zeros((1, 2)), np.zeros(1, np.int64), 2)
    assert np.isnan(found.xyz).all()
    assert np.isnan(found.covariance).all()
    assert found.views.tolist() == [1, 0]
    assert found.parallax.tolist() == pytest.approx([0, 0])
    assert len(triangulate(np.zeros((0, 4, 4)), np.zeros((0, 2)), np.zeros(0, np.int64), 0).xyz) == 0


def test_parallax_of_two_rays_is_half_the_angle_between_them():
    """The best direction lies in the middle, so each of the two rays is half of the angle off it."""
    found = triangulate(along_x(-0.5, 0.5), np.array([[0.1, 0.0], [-0.1, 0.0]]), np.zeros(2, np.int64), 1)
    np.testing.assert_allclose(found.xyz, [[0, 0, 5]], atol=1e-12)
    assert found.parallax[0] == pytest.approx(np.arctan(0.1))


def test_errors_are_distances_in_pixels_and_infinite_behind_the_camera():
    camera = PinholeCamera(100, 80, 50.0, 50.0, 49.5, 39.5)
    keyframes = Keyframes(np.arange(1), np.zeros(1), along_x(0.0), np.zeros(1, np.int32))
    points = MapPoints(np.array([[0.0, 0, 2], [0, 0, -2]]), np.zeros((2, 3), np.uint8))
    uv = np.array([[52.5, 43.5], [49.5, 39.5]])
    found = reprojection_errors(camera, keyframes, points, observed(np.array([0, 0]), np.array([0, 1]), uv))
    assert found.tolist() == [5.0, np.inf]


def test_rows_come_by_group_and_small_groups_are_left_out():
    group = np.array([7, 2, 7, 2, 7, 5])
    assert [rows.tolist() for rows in rows_by_group(group)] == [[1, 3], [5], [0, 2, 4]]
    assert [rows.tolist() for rows in rows_by_group(group, 3)] == [[0, 2, 4]]
    assert rows_by_group(np.zeros(0, np.int64)) == []


def test_parallax_is_the_angle_between_the_first_and_the_last_ray():
    wTc = np.tile(np.eye(4), (4, 1, 1))
    wTc[:, 0, 3] = [0, 0.1, 0.2, 0.3]
    keyframes = Keyframes(np.arange(4), np.arange(4.0), wTc, np.zeros(4, np.int32))
    points = MapPoints(np.array([[0.0, 0, 2], [0.5, 0, 3], [0.2, 0.3, 4]]), np.zeros((3, 3), np.uint8))
    keyframe, point = np.array([0, 1, 2, 3, 0, 1, 1, 2, 3]), np.array([0, 0, 0, 0, 1, 1, 2, 2, 2])
    seen = observed(keyframe, point)
    found = extreme_parallax(keyframes, points, seen)
    # Point 0 lies 2 m ahead of keyframe 0, and keyframe 3 stands 0.3 m to the right.
    assert found[0] == pytest.approx(np.degrees(np.arctan2(0.3, 2)))
    # Points 1 and 2: the cosine rule with the three sides of the triangle.
    for point, a, b in ((1, 0, 1), (2, 1, 3)):
        rays = points.xyz[point] - wTc[[a, b], :3, 3]
        u, v = np.linalg.norm(rays, axis=1)
        side = wTc[b, 0, 3] - wTc[a, 0, 3]
        assert found[point] == pytest.approx(np.degrees(np.arccos((u**2 + v**2 - side**2) / (2 * u * v))))
    first = seen.keyframe == 0
    once = observed(seen.keyframe[first], seen.point[first])
    assert extreme_parallax(keyframes, points, once).tolist() == [0, 0, 0]
