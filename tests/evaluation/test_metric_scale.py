"""A metric trajectory of the wrong scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.types import Trajectory
from prgbd.evaluation.metric_scale import scale_doubts, true_scale
from tests.training.scenes import WallSequence, true_slam_result


@pytest.fixture(scope="module")
def wall():
    sequence = WallSequence(24, step=0.25)
    return replace(true_slam_result(sequence), mode="rgbd"), np.asarray(sequence.poses)


def scaled(result, factor, mode="rgbd"):
    """The same result with all lengths multiplied, as from depth in another unit."""
    wTc, keyframes = result.trajectory.wTc.copy(), result.keyframes.wTc.copy()
    wTc[:, :3, 3] *= factor
    keyframes[:, :3, 3] *= factor
    return replace(
        result,
        mode=mode,
        trajectory=replace(result.trajectory, wTc=wTc),
        keyframes=replace(result.keyframes, wTc=keyframes),
        observations=replace(result.observations, depth=result.observations.depth * np.float32(factor)),
    )


def test_a_right_scale_has_no_doubts(wall):
    result, truth = wall
    assert scale_doubts(result, truth, 5000) == []
    assert scale_doubts(scaled(result, 1.2), truth, 5000) == []
    assert scale_doubts(result, None) == []
    assert true_scale(result, truth) == pytest.approx(1)


@pytest.mark.parametrize(
    ("factor", "levels", "words"),
    [
        (
            0.2,
            5000,
            "5 times too small against the true poses: check data.depth_levels_per_metre, 1000 in place of 5000",
        ),
        (5, 1000, "5 times too large against the true poses: check data.depth_levels_per_metre, 5000 in place of 1000"),
        (0.7, 1000, "700 in place of 1000"),
        (0.2, None, "check its unit"),
    ],
)
def test_depth_in_another_unit_is_seen_by_the_true_poses_alone(wall, factor, levels, words):
    result, truth = wall
    wrong = scaled(result, factor)
    (doubt,) = scale_doubts(wrong, truth, levels)
    assert words in doubt
    assert scale_doubts(wrong, None, levels) == []


def test_of_stereo_the_baseline_is_named_and_a_free_scale_is_no_fault(wall):
    result, truth = wall
    (doubt,) = scale_doubts(scaled(result, 2, "stereo"), truth)
    assert "2 times too large" in doubt
    assert "baseline" in doubt
    assert scale_doubts(scaled(result, 2, "mono"), truth) == []
    pseudo = scaled(result, 2)
    assert scale_doubts(replace(pseudo, stats={**pseudo.stats, "pseudo_depth": {}}), truth) == []


def test_depth_that_contradicts_triangulation_is_said_without_truth(wall):
    result, _ = wall
    depth = result.observations.depth * np.float32(0.6)
    (doubt,) = scale_doubts(replace(result, observations=replace(result.observations, depth=depth)), None)
    assert "0.60 times the triangulated depth" in doubt
    assert "registered" in doubt


def test_a_path_that_says_nothing_about_scale_has_none(wall):
    result, truth = wall
    noise = np.random.default_rng(0).normal(0, 2, (len(result.trajectory), 3))
    wTc = result.trajectory.wTc.copy()
    wTc[:, :3, 3] += noise
    assert true_scale(replace(result, trajectory=replace(result.trajectory, wTc=wTc)), truth) is None
    few = result.trajectory
    short = Trajectory(few.frame_index[:5], few.timestamp[:5], few.wTc[:5])
    assert true_scale(replace(result, trajectory=short), truth) is None
