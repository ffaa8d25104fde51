"""Keyframes and the points that their measured depth gives."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.camera.depth_noise import DepthNoise
from prgbd.plugins.slam.orb_gtsam.map.keyframe_creation import CLOSEST_LIFTED, KeyframeCreator
from tests.plugins.slam.orb_gtsam.cloud import Cloud, at


def creator(cloud: Cloud) -> KeyframeCreator:
    return KeyframeCreator(cloud.camera, cloud.map, cloud.covisibility)


def add(cloud: Cloud, cTw: np.ndarray) -> tuple[int, np.ndarray]:
    features, shown = cloud.see(cTw)
    return creator(cloud).add(7, 0.7, cTw, features, np.full(len(shown), -1, np.int64)), shown


@pytest.mark.parametrize(("close", "lifted_points"), [(7.0, CLOSEST_LIFTED), (9.8, None)], ids=["closest", "close"])
def test_close_keypoints_become_points_and_at_least_the_closest_ones(close: float, lifted_points: int | None) -> None:
    cloud, cTw = Cloud(160), at(0.3, 0.1, -0.2)
    cloud.camera.close_depth = close
    k, shown = add(cloud, cTw)
    depth = cloud.xyz[shown, 2] + 0.2
    lifted = cloud.map.points_of(k) >= 0
    expected = depth <= (close if lifted_points is None else np.sort(depth)[lifted_points - 1] + 1e-6)
    assert expected.sum() == lifted_points or (lifted_points is None and 100 < expected.sum() < 160)
    np.testing.assert_array_equal(lifted, expected)
    np.testing.assert_allclose(
        cloud.map.points.xyz[cloud.map.points_of(k)[lifted]], cloud.xyz[shown[lifted]], atol=1e-4
    )
    ((created, new),) = cloud.map.probation
    assert (created, len(new)) == (k, lifted.sum())
    assert cloud.map.counts.keyframes_added == 1
    assert (cloud.map.points.distance_range[new] > 0).all()


def test_a_first_keyframe_lifts_all_that_has_depth() -> None:
    cloud = Cloud()
    k, shown = add(cloud, at(0.0))
    points = creator(cloud).lift_all(k)
    assert (points >= 0).all()
    np.testing.assert_allclose(cloud.map.points.xyz[points], cloud.xyz[shown], atol=1e-4)


def test_without_depth_nothing_is_lifted() -> None:
    cloud = Cloud(mono=True)
    k, _ = add(cloud, at(0.0))
    assert (cloud.map.points_of(k) < 0).all()
    assert not cloud.map.probation


@pytest.mark.parametrize(("noise", "scale"), [(DepthNoise(relative=0.15), 1.0), (DepthNoise(), 1.3)])
def test_a_networks_depth_takes_the_scale_of_the_map_and_a_sensors_does_not(noise: DepthNoise, scale: float) -> None:
    cloud = Cloud(noise=noise)
    known = np.arange(80) < 40
    first, rows = cloud.keyframe(at(0.0))
    points = cloud.place(first, rows, np.flatnonzero(known))
    features, shown = cloud.see(at(0.0), depth_factor=1.3)
    k = creator(cloud).add(1, 0.1, at(0.0), features, points[shown])
    new = ~known[shown]
    found = cloud.map.points.xyz[cloud.map.points_of(k)[new]]
    np.testing.assert_allclose(found, scale * cloud.xyz[shown[new]], atol=1e-4)


def test_a_new_keyframe_makes_the_covisibility_graph_forget() -> None:
    cloud = Cloud()
    a, shown = add(cloud, at(0.0))
    assert cloud.covisibility.of(a).tolist() == []
    features, again = cloud.see(at(0.1))
    by_point = np.empty(80, np.int64)
    by_point[shown] = cloud.map.points_of(a)
    b = creator(cloud).add(8, 0.8, at(0.1), features, by_point[again])
    assert cloud.covisibility.of(a).tolist() == [b]
