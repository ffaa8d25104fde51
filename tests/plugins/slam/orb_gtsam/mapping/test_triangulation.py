"""New points from two keyframes of a cloud."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.mapping.triangulation import create_points
from tests.plugins.slam.orb_gtsam.cloud import Cloud, at

KNOWN = np.arange(20)
NEW = np.arange(20, 80)


def two_views(second: np.ndarray, *, mono: bool = True) -> tuple[Cloud, int, int, np.ndarray, np.ndarray]:
    """Return a cloud of which two keyframes know some points; the keyframes, and the keypoints of all points."""
    cloud = Cloud(mono=mono)
    other, rows_other = cloud.keyframe(at(0.0))
    points = cloud.place(other, rows_other, KNOWN)
    k, rows = cloud.keyframe(second, points)
    return cloud, k, other, rows, rows_other


def create(cloud: Cloud, k: int, other: int) -> np.ndarray:
    return create_points(cloud.map, cloud.camera, k, other)


@pytest.mark.parametrize("mono", [True, False])
@pytest.mark.parametrize("second", [at(0.8), at(0.3, 0.5), at(0.2, 0.1, 0.7)], ids=["beside", "below", "ahead"])
def test_points_come_to_their_true_place(second: np.ndarray, mono: bool) -> None:
    cloud, k, other, rows, rows_other = two_views(second, mono=mono)
    new = create(cloud, k, other)
    by_cloud, by_other = cloud.map.points_of(k)[rows], cloud.map.points_of(other)[rows_other]
    found = NEW[by_cloud[NEW] >= 0]
    assert len(new) == len(found) > 45
    np.testing.assert_array_equal(by_cloud, by_other)
    np.testing.assert_allclose(cloud.map.points.xyz[by_cloud[found]], cloud.xyz[found], atol=0.02)
    assert set(new.tolist()) == set(by_cloud[found].tolist())
    assert (cloud.map.points.created[new] == k).all()


def test_what_has_a_point_is_left_alone() -> None:
    cloud, k, other, rows, _ = two_views(at(0.8))
    before = cloud.map.points_of(k)[rows[KNOWN]].copy()
    create(cloud, k, other)
    np.testing.assert_array_equal(cloud.map.points_of(k)[rows[KNOWN]], before)
    assert len(create(cloud, k, other)) == 0


@pytest.mark.parametrize(
    ("mono", "step", "enough"), [(True, 0.07, False), (True, 0.3, True), (False, 0.09, False), (False, 0.3, True)]
)
def test_keyframes_must_be_apart(mono: bool, step: float, enough: bool) -> None:
    # A hundredth of the median depth of 8 m in mono, the baseline of 0.1 m with depth.
    cloud, k, other, _, _ = two_views(at(step), mono=mono)
    assert (len(create(cloud, k, other)) > 0) == enough


def test_a_partner_off_the_epipolar_line_is_none() -> None:
    cloud, k, other, rows, _ = two_views(at(0.8))
    cloud.map.keyframes.uv[k, rows[NEW[:10]], 1] += 15.0
    create(cloud, k, other)
    made = cloud.map.points_of(k)[rows] >= 0
    assert not made[NEW[:10]].any()
    assert made[NEW[10:]].mean() > 0.8


def test_keypoints_that_look_different_are_not_joined() -> None:
    cloud, k, other, rows, _ = two_views(at(0.8))
    cloud.map.keyframes.descriptor[k, rows[NEW[:10]]] ^= np.uint64(0xFFFFFFFF)
    create(cloud, k, other)
    assert (cloud.map.points_of(k)[rows[NEW[:10]]] < 0).all()
