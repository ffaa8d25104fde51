"""What leaves the map, on a cloud that a few keyframes see."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.map.culling import cull_new_points, drop_depths, drop_observations, is_redundant
from tests.plugins.slam.orb_gtsam.cloud import CLOSE, Cloud, at

ALL = np.arange(80)


def seen_by(keyframes: int, *, mono: bool = False) -> tuple[Cloud, np.ndarray]:
    """Return a cloud that so many keyframes see, and the map points of it."""
    cloud = Cloud(mono=mono)
    k, rows = cloud.keyframe(at(0.0))
    points = cloud.place(k, rows, ALL)
    for step in range(1, keyframes):
        cloud.keyframe(at(0.1 * step), points)
    return cloud, points


def test_new_points_that_are_rarely_found_go() -> None:
    cloud, points = seen_by(3)
    cloud.map.points.visible[points[:5]], cloud.map.points.found[points[:5]] = 9, 2
    cloud.map.points.visible[points[5:10]], cloud.map.points.found[points[5:10]] = 8, 2
    cloud.map.probation.append((2, points))
    cull_new_points(cloud.map, 2, mono=False)
    np.testing.assert_array_equal(np.flatnonzero(cloud.map.points.bad[points]), np.arange(5))
    assert cloud.map.counts.points_culled == 5
    assert len(cloud.map.probation[0][1]) == 75


@pytest.mark.parametrize(
    ("mono", "observations", "kept"), [(True, 2, False), (True, 3, True), (False, 1, False), (False, 2, True)]
)
def test_points_that_few_keyframes_see_go_after_two_more(mono: bool, observations: int, kept: bool) -> None:
    cloud, points = seen_by(observations, mono=mono)
    cloud.map.probation.append((5, points))
    cull_new_points(cloud.map, 6, mono=mono)
    assert not cloud.map.points.bad[points].any()
    cull_new_points(cloud.map, 7, mono=mono)
    assert cloud.map.points.bad[points].all() != kept
    cull_new_points(cloud.map, 8, mono=mono)
    assert not cloud.map.probation


def test_dropped_observations_take_points_with_them_that_keep_too_few() -> None:
    cloud, points = seen_by(3, mono=True)
    outliers = cloud.map.observations(points[:2])
    first = outliers[(outliers[:, 0] == 1) & (outliers[:, 2] == 0)]
    drop_observations(cloud.map, first, double=False)
    assert cloud.map.points.bad[points].tolist() == [True] + [False] * 79
    assert (cloud.map.points_of(0) >= 0).sum() == 79
    assert cloud.map.observation_counts(points[1:], double=False).tolist() == [3] * 79


def test_with_depth_two_observations_are_enough_to_stay() -> None:
    cloud, points = seen_by(3)
    seen = cloud.map.observations(points)
    drop_observations(cloud.map, seen[seen[:, 0] == 1], double=True)
    assert not cloud.map.points.bad[points].any()
    assert cloud.map.observation_counts(points, double=True).tolist() == [4] * 80


def test_a_dropped_depth_leaves_a_monocular_observation() -> None:
    cloud, points = seen_by(2)
    seen = cloud.map.observations(points[:3])
    drop_depths(cloud.map, seen[seen[:, 0] == 1])
    assert cloud.map.observation_counts(points[:4], double=True).tolist() == [3, 3, 3, 4]
    assert cloud.map.counts.depths_rejected == 3


def test_a_keyframe_is_redundant_if_three_others_see_its_points_as_well() -> None:
    cloud, points = seen_by(3)
    assert not is_redundant(cloud.map, 1, 0.0, 0.0)
    half = np.where(ALL < 40, points, -1)
    cloud.keyframe(at(0.4), half)
    assert is_redundant(cloud.map, 1, 0.49, 0.0)
    assert not is_redundant(cloud.map, 1, 0.5, 0.0)
    # A coarser view does not count as one as good.
    cloud.map.keyframes.octave[3] = 2
    assert not is_redundant(cloud.map, 1, 0.0, 0.0)


def test_only_close_points_make_a_keyframe_with_depth_worth_keeping() -> None:
    cloud, points = seen_by(3)
    close = cloud.xyz[:, 2] <= CLOSE
    cloud.keyframe(at(0.4), np.where(close, points, -1))
    assert is_redundant(cloud.map, 1, 0.99, CLOSE)
    assert not is_redundant(cloud.map, 1, 0.99, 0.0)
