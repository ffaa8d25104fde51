"""The error of measured depth, judged by triangulation alone: it must find what was put in."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.core.types import Frame
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.diagnostics.depth_error import variance_components
from tests.plugins.slam.orb_gtsam.walls import CAMERA, path, view

KEYFRAMES, DEPTHS = 60, 80


@pytest.mark.parametrize(("own", "common"), [(0.15, 0.0), (0.12, 0.09), (0.03, 0.1), (0.0, 0.0)])
def test_components_are_those_that_the_errors_were_drawn_from(own, common) -> None:
    rng = np.random.default_rng(3)
    keyframe = np.repeat(np.arange(KEYFRAMES), DEPTHS)
    noise = rng.uniform(0.02, 0.08, len(keyframe))
    error = 0.4 + common * rng.standard_normal(KEYFRAMES)[keyframe] + own * rng.standard_normal(len(keyframe))
    error += noise * rng.standard_normal(len(keyframe))
    error[rng.random(len(keyframe)) < 0.05] += 1.5  # wrong matches
    shuffled = rng.permutation(len(keyframe))
    found = variance_components(error[shuffled], noise[shuffled], keyframe[shuffled])
    assert found is not None
    assert (found.keyframes, found.depths) == (KEYFRAMES, KEYFRAMES * DEPTHS)
    total = np.hypot(own, common)
    assert found.sigma == pytest.approx(total, rel=0.2, abs=0.03)
    if total > 0:
        assert found.shared == pytest.approx(common**2 / total**2, abs=0.2)


def test_few_depths_or_keyframes_say_nothing() -> None:
    rng = np.random.default_rng(0)
    errors, noise = rng.standard_normal(400), np.zeros(400)
    assert variance_components(errors, noise, np.arange(400) // 10) is None
    assert variance_components(errors, noise, np.arange(400) // 100) is None


@pytest.mark.parametrize(("own", "common"), [(0.15, 0.0), (0.05, 0.1)])
def test_slam_finds_the_noise_that_its_depth_was_given(own, common) -> None:
    rng = np.random.default_rng(5)
    scales = common * rng.standard_normal(40)

    def noisy(frame: Frame) -> Frame:
        assert frame.depth is not None
        # Blocks as large as a feature, so that neighbouring keypoints err apart from each other.
        blocks = own * np.kron(rng.standard_normal((60, 80)), np.ones((8, 8)))
        log = scales[frame.index] + blocks[: frame.depth.shape[0], : frame.depth.shape[1]]
        return frame.with_depth((frame.depth * np.exp(log)).astype(np.float32))

    # Four seconds give too few keyframes for statistics unless one asks for more.
    with OrbGtsamSLAM(keyframes={"ratio_pseudo": 0.8}) as system:
        system.reset(CAMERA, "pseudo_rgbd", baseline=0.1, fps=10.0)
        for i, wTc in enumerate(path(len(scales))):
            system.track(noisy(view(i, wTc)))
        result = system.finish()
    found = result.stats["depth_error"]
    # Of the scales that the keyframes happened to draw.
    drawn = scales[result.keyframes.frame_index]
    drawn_variance = float(np.var(drawn))
    total = drawn_variance + own**2
    assert found["sigma"] == pytest.approx(np.sqrt(total), rel=0.25)
    assert found["shared"] == pytest.approx(drawn_variance / total, abs=0.2)
