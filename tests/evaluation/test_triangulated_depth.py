"""Depth judged by triangulation alone, on a world whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prgbd.evaluation.triangulated_depth import disagreement, triangulated
from tests.training.scenes import WallSequence, true_slam_result


@pytest.fixture(scope="module")
def wall():
    return true_slam_result(WallSequence(24, step=0.25))


def compared(result):
    return disagreement(result, result.observations)


def measured(result, depth):
    """The same result with other measurements of depth at the keypoints."""
    return replace(result, observations=replace(result.observations, depth=depth.astype(np.float32)))


def test_points_are_found_again_without_any_depth(wall):
    result = wall
    points, good = triangulated(result)
    assert good.mean() > 0.5
    np.testing.assert_allclose(points[good], result.points.xyz[good], atol=0.02)
    assert np.isnan(points[~good]).all()


def test_disagreement_sees_shape_and_not_scale(wall):
    result = wall
    depth = result.observations.depth.astype(float)
    within, between = compared(result)
    assert within < 2e-3
    assert between < 2e-3
    scaled = compared(measured(result, 0.3 * depth))
    assert scaled[0] == pytest.approx(within, abs=1e-6)
    per_keyframe = np.exp(0.2 * (result.observations.keyframe % 2))
    wandering = compared(measured(result, depth * per_keyframe))
    assert wandering[0] == pytest.approx(within, abs=1e-6)
    assert wandering[1] == pytest.approx(0.1, rel=0.05)
    noise = np.random.default_rng(0).normal(0, 0.1, len(depth))
    assert compared(measured(result, depth * np.exp(noise)))[0] == pytest.approx(0.08, rel=0.1)


def test_a_map_that_follows_wrong_depth_does_not_count_as_agreement(wall):
    """Squeezed depth with points moved along their rays to match: the map agrees with it, triangulation does not."""
    result = wall
    squeezed = 5 * (result.observations.depth.astype(float) / 5) ** 0.5
    assert compared(measured(result, squeezed))[0] > 10 * compared(result)[0]
