"""Depth that is less certain than keypoints: weights, borders, and what SLAM makes of a network's depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.types import Frame, SlamResult
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.camera.depth_noise import PSEUDO_DEPTH, DepthNoise, depth_noise, spread_around
from prgbd.plugins.slam.orb_gtsam.features.extraction import OrbExtractor
from prgbd.plugins.slam.orb_gtsam.settings import DepthOptions, FeatureOptions
from tests.plugins.slam.orb_gtsam.pseudo_depth import WrongDepth
from tests.plugins.slam.orb_gtsam.walls import CAMERA, error, path, view

POSES = path(40)


def camera(noise: DepthNoise) -> CameraModel:
    return CameraModel(CAMERA, False, 0.1, 4.0, 1.2 ** np.arange(8.0), 16, noise=noise)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [view(i, wTc) for i, wTc in enumerate(POSES)]


def run(frames: list[Frame], mode: str, **options) -> SlamResult:
    with OrbGtsamSLAM(**options) as system:
        system.reset(CAMERA, mode, baseline=0.1, fps=10.0)
        for frame in frames:
            system.track(frame)
        return system.finish()


def off(result: SlamResult, *, scale: bool = True) -> float:
    assert result.tracked_frames == len(POSES)
    truth = np.stack([POSES[i][:3, 3] for i in result.trajectory.frame_index])
    return error(result.trajectory.positions, truth, scale=scale)


def test_the_right_columns_spread_is_what_wrong_depths_make_of_it() -> None:
    noise = DepthNoise(relative=0.1, far=0.02)
    depth = np.array([1.0, 4.0, 0.0])
    drawn = depth[:2] * (1 + (0.1 + 0.02 * depth[:2] / 0.1) * np.linspace(-1e-4, 1e-4, 2)[:, None])
    columns = CAMERA.fx * 0.1 / drawn
    expected = np.abs(columns[0] - columns[1]) / 2e-4
    np.testing.assert_allclose(camera(noise).right_sigma(depth)[:2], expected, rtol=1e-4)
    assert camera(noise).right_sigma(depth)[2] == 0


def test_weights_join_the_noise_of_keypoint_and_depth() -> None:
    octave, depth = np.array([0, 3, 3], np.int32), np.array([2.0, 2.0, 0.0], np.float32)
    plain = camera(DepthNoise()).weights(octave, depth)
    np.testing.assert_array_equal(plain, camera(DepthNoise()).inverse_variance[octave])
    uncertain = camera(DepthNoise(relative=0.2, shared=9.0))
    weights, alone = uncertain.weights(octave, depth), uncertain.weights(octave, depth, shared=1.0)
    np.testing.assert_array_equal(weights[:, 0], plain)
    added = uncertain.right_sigma(depth) ** 2
    np.testing.assert_allclose(1 / alone[:, 1], 1 / plain + added)
    np.testing.assert_allclose(1 / weights[:, 1], 1 / plain + 9 * added)
    assert weights[2, 1] == plain[2]


def test_auto_means_a_sensor_or_a_network_by_the_mode() -> None:
    options = DepthOptions()
    assert depth_noise(options, "rgbd", 800) == DepthNoise()
    followed = depth_noise(options, "pseudo_rgbd", 800)
    assert followed == replace(PSEUDO_DEPTH, shared=followed.shared)
    assert followed.shared > 100 * 800, "depth that was made to fit the map has no say about poses"
    as_it_is = depth_noise(DepthOptions(follow=False), "pseudo_rgbd", 800)
    assert as_it_is == replace(PSEUDO_DEPTH, shared=400.0)
    fixed = DepthOptions(sigma=0.3, shared=1, fallback=False, border=0.2)
    expected = DepthNoise(relative=0.3, shared=1.0, fallback=False, border=0.2)
    assert depth_noise(fixed, "pseudo_rgbd", 9) == depth_noise(fixed, "rgbd", 9) == expected


def test_borders_are_where_depth_jumps() -> None:
    depth = np.full((40, 60), 2.0, np.float32)
    depth[:, 30:] = 4.0
    depth[10:20, 5:10] = 0.0
    spread = spread_around(depth)
    assert spread[30, 29] == spread[30, 26] == pytest.approx(0.5)
    assert spread[30, 20] == 0
    assert not spread[:, :20].any()


def test_keypoints_at_borders_make_no_stereo_observation(frames) -> None:
    free, held = run(frames[:3], "rgbd"), run(frames[:3], "rgbd", depth={"border": 0.2})
    assert len(held.points) > 0.5 * len(free.points)
    extractor = OrbExtractor(FeatureOptions(), CAMERA.width, CAMERA.height)
    image, depth = frames[0].image, frames[0].depth
    every, some = extractor.extract(image, depth, 27.0), extractor.extract(image, depth, 27.0, border=0.2)
    lost = (every.u_right >= 0) & (some.u_right < 0)
    at = np.rint(every.uv).astype(int)
    np.testing.assert_array_equal(lost, spread_around(depth)[at[:, 1], at[:, 0]] > 0.2)
    assert 0 < lost.mean() < 0.3


def test_depth_biased_near_by_15_percent_does_less_harm_with_the_model(frames) -> None:
    wrong = [WrongDepth(near_bias=0.3)(frame) for frame in frames]
    # The nearest wall is at half the largest depth, so its depth is 15 % too large.
    believed, doubted = run(wrong, "rgbd"), run(wrong, "pseudo_rgbd", depth={"follow": False})
    assert off(doubted, scale=False) < 0.6 * off(believed, scale=False)


def test_the_statistics_tell_how_wrong_depth_is(frames) -> None:
    corrupt = WrongDepth(scale=0.08, patches=0.1, blur=2.0, memory=10)
    stats = run([corrupt(frame) for frame in frames], "pseudo_rgbd").stats
    ratio, spread, rejected = (np.array(stats[f"depth_{name}"][2:], float) for name in ("ratio", "spread", "rejected"))
    assert 0.02 < np.std(np.log(ratio)) < 0.2
    assert 0.02 < np.median(spread) < 0.2
    assert 0.0 <= np.median(rejected) < 0.3
    exact = run(frames[:10], "rgbd").stats
    assert np.median(np.array(exact["depth_spread"][2:], float)) < 0.01


def test_a_sensors_depth_is_as_good_with_the_model(frames) -> None:
    assert off(run(frames, "pseudo_rgbd"), scale=False) < 0.02
