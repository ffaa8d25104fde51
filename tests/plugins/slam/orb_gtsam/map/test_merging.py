"""Merging of duplicate points between two keyframes that see the same cloud."""

from __future__ import annotations

import numpy as np

from prgbd.plugins.slam.orb_gtsam.map.merging import merge_duplicates
from tests.plugins.slam.orb_gtsam.cloud import Cloud, at

ALL = np.arange(80)


def two_views(second: np.ndarray) -> tuple[Cloud, int, np.ndarray, int, np.ndarray]:
    """Return a cloud whose points one keyframe placed; and another keyframe which placed those in ``second`` anew."""
    cloud = Cloud()
    a, rows_a = cloud.keyframe(at(0.0))
    first = cloud.place(a, rows_a, ALL)
    b, rows_b = cloud.keyframe(at(0.2))
    return cloud, b, first, *(cloud.place(b, rows_b, second), rows_b)


def merge(cloud: Cloud, k: int, points: np.ndarray) -> int:
    return merge_duplicates(cloud.map, cloud.camera, k, points)


def test_free_keypoints_observe_the_points_that_they_show() -> None:
    cloud, b, first, _, rows = two_views(ALL[:0])
    assert merge(cloud, b, first) == 80
    np.testing.assert_array_equal(cloud.map.points_of(b)[rows], first)
    assert (cloud.map.observation_counts(first, double=False) == 2).all()


def test_the_point_that_was_there_before_takes_the_place_of_an_equal_one() -> None:
    cloud, b, first, second, rows = two_views(ALL[:30])
    assert merge(cloud, b, first) == 80
    np.testing.assert_array_equal(cloud.map.points_of(b)[rows], first)
    assert cloud.map.points.bad[second[:30]].all()
    np.testing.assert_array_equal(cloud.map.current(second[:30]), first[:30])
    # What both counted is added up.
    assert (cloud.map.points.visible[first[:30]] == 2).all()


def test_the_point_with_more_observations_stays() -> None:
    cloud, b, first, second, _ = two_views(ALL[:30])
    c, _ = cloud.keyframe(at(0.3), second)
    merge(cloud, b, first)
    np.testing.assert_array_equal(cloud.map.current(first[:30]), second[:30])
    assert (cloud.map.observation_counts(second[:30], double=False) == 3).all()
    assert not cloud.map.points.bad[first[30:]].any()
    assert (cloud.map.points_of(c) >= 0).sum() == 30


def test_points_that_it_sees_already_or_that_are_gone_are_left_alone() -> None:
    cloud, b, first, _, _ = two_views(ALL[:0])
    merge(cloud, b, first[:40])
    assert merge(cloud, b, first[:40]) == 0
    cloud.map.remove_points(first[40:50])
    assert merge(cloud, b, first[40:]) == 30


def test_what_does_not_fit_is_not_merged() -> None:
    cloud, b, first, _, _ = two_views(ALL[:0])
    pts = cloud.map.points
    pts.xyz[first[:10]] += [0.5, 0.0, 0.0]  # 25 pixels beside its keypoint or more
    pts.descriptor[first[10:20]] ^= np.uint64(0xFFFFFFFF)  # 128 bits of 256
    pts.xyz[first[20:30], 2] *= 0.7  # its depth contradicts the measured one
    assert merge(cloud, b, first) == 50
