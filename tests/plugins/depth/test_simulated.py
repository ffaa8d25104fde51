"""The simulated depth sensor: its statistics, that every frame follows from its number, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prgbd import make_depth
from prgbd.core.errors import ConfigError, ContractError, DataError
from prgbd.core.wrappers import wrap
from prgbd.loop.sensing import DepthSensor
from prgbd.plugins.depth.simulated import SimulatedDepth
from prgbd.plugins.depth.simulated.noise import image_noise, stationary, video_noise
from tests.loop.fakes import WALL, Wall

ALL = {
    "scale_sigma": 0.1,
    "own_sigma": 0.2,
    "own_length": 4.0,
    "own_frames": 3.0,
    "shift": 0.01,
    "shift_sigma": 0.02,
    "bias": 0.1,
    "outliers": 0.1,
    "blur": 1.0,
}


class Step(Wall):
    """A wall whose right half is farther away, with an unknown corner."""

    def depth(self, index):
        depth = super().depth(index)
        depth[:, 48:] = 4 * WALL
        depth[:8, :8] = 0
        return depth


def correlation(values: np.ndarray, lag: int) -> float:
    return float(np.mean(values[lag:] * values[:-lag]))


@pytest.mark.parametrize("length", [0.0, 1.0, 10.0])
def test_the_process_has_its_variance_and_its_length(length) -> None:
    values = stationary([1], 200_000, length)
    assert values.var() == pytest.approx(1.0, abs=0.03)
    for lag in (1, 3, 10):
        assert correlation(values, lag) == pytest.approx(np.exp(-lag / length) if length else 0.0, abs=0.03)


def test_the_process_is_stationary_from_its_first_value_and_a_longer_one_begins_alike() -> None:
    first = [stationary([seed], 3, 30.0) for seed in range(3000)]
    np.testing.assert_allclose(np.var(first, axis=0), 1.0, atol=0.09)
    np.testing.assert_array_equal(stationary([5], 50, 7.0)[:20], stationary([5], 20, 7.0))


@pytest.mark.parametrize("length", [0.0, 3.0, 12.0])
def test_noise_of_an_image_has_its_variance_everywhere_and_its_length(length) -> None:
    fields = np.stack([image_noise([2, i], (48, 64), length) for i in range(300)])
    variance = fields.var(axis=0)
    assert variance.mean() == pytest.approx(1.0, abs=0.06)
    assert variance[[0, 0, -1, -1], [0, -1, 0, -1]].mean() == pytest.approx(1.0, abs=0.2)
    for lag in (1, 3, 12):
        expected = np.exp(-((lag / length) ** 2)) if length else 0.0
        assert np.mean(fields[:, :, lag:] * fields[:, :, :-lag]) == pytest.approx(expected, abs=0.05)


def test_noise_of_a_video_keeps_its_variance_and_forgets() -> None:
    fields = np.stack([video_noise([3], frame, (40, 40), 0.0, 8.0) for frame in range(80)])
    np.testing.assert_allclose(fields.var(axis=(1, 2)), 1.0, atol=0.15)
    near, length, far = (np.mean(fields[lag:] * fields[:-lag]) for lag in (1, 8, 16))
    assert near > 0.9
    assert length == pytest.approx(1 / np.pi, abs=0.05)
    assert far == pytest.approx(0.0, abs=0.05)


def test_without_errors_it_is_the_truth() -> None:
    depth, truth = SimulatedDepth().depth(Step(), 3), Step().depth(3)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth[truth > 0], truth[truth > 0])
    assert (depth[truth == 0] == 4 * WALL).all()


def test_a_frame_has_the_errors_that_were_asked_for() -> None:
    sequence = Wall(frames=1500)
    errors = SimulatedDepth(scale_sigma=0.1, scale_length=5, own_sigma=0.2, bias=0.05)
    wrong = np.stack([np.log(errors.depth(sequence, i) / WALL) for i in range(len(sequence))])
    scale = wrong.mean(axis=(1, 2))
    assert scale.mean() == pytest.approx(0.05, abs=0.03)
    assert scale.std() == pytest.approx(0.1, abs=0.015)
    assert correlation(scale - scale.mean(), 5) / scale.var() == pytest.approx(np.exp(-1), abs=0.15)
    assert (wrong - scale[:, None, None]).std() == pytest.approx(0.2, abs=0.002)


def test_the_shift_is_one_of_inverse_depth() -> None:
    depth = SimulatedDepth(shift=-0.05, farthest=50).depth(Step(), 0)
    near, far = depth[40, 10], depth[40, 60]
    assert 1 / near == pytest.approx(1 / WALL - 0.05, rel=1e-5)
    assert 1 / far == pytest.approx(max(1 / (4 * WALL) - 0.05, 1 / 50), rel=1e-5)


def test_blobs_of_outliers_have_their_share_and_wander() -> None:
    sensor = SimulatedDepth(outliers=0.1, outlier_factor=0.25, outlier_length=6, outlier_frames=4)
    depth = np.stack([sensor.depth(Wall(), i) for i in range(120)])
    assert np.unique(depth).tolist() == [WALL / 4, WALL]
    blobs = depth < WALL
    assert blobs.mean() == pytest.approx(0.1, abs=0.02)
    assert 0.4 < (blobs[1:] & blobs[:-1]).sum() / blobs[1:].sum() < 0.95


def test_blur_smears_borders_alone() -> None:
    truth, depth = Step().depth(0), SimulatedDepth(blur=1.5).depth(Step(), 0)
    assert WALL < depth[40, 47] < depth[40, 48] < 4 * WALL
    np.testing.assert_allclose(depth[20:, :40], truth[20:, :40], rtol=1e-6)


def test_every_frame_follows_from_its_number_in_any_order() -> None:
    upwards, downwards = SimulatedDepth(**ALL), SimulatedDepth(**ALL)
    first = {i: upwards.depth(Step(), i) for i in range(6)}
    for i in reversed(range(6)):
        np.testing.assert_array_equal(downwards.depth(Step(), i), first[i])
    assert not np.array_equal(SimulatedDepth(**ALL, seed=1).depth(Step(), 2), first[2])
    assert not np.array_equal(SimulatedDepth(**ALL).depth(Step("10"), 2), first[2])


def test_it_is_a_depth_sensor_and_wrappers_work_on_it(tmp_path) -> None:
    network = make_depth("simulated", **ALL)
    plain = DepthSensor(network, Step(), tmp_path, name="simulated")
    np.testing.assert_allclose(plain.depth(4), SimulatedDepth(**ALL).depth(Step(), 4), rtol=1e-6)
    mirrored = DepthSensor(wrap(network, ["flip_averaged", {"scaled": {"factor": 2}}]), Step(), tmp_path, name="s")
    np.testing.assert_allclose(mirrored.depth(4), 2 * plain.depth(4), rtol=1e-5)


def test_other_errors_do_not_share_a_cache(tmp_path) -> None:
    paths = {DepthSensor(make_depth("simulated", bias=b), Wall(), tmp_path, name="s").path for b in (0.0, 0.1)}
    assert len(paths) == 2


def test_an_image_alone_is_refused() -> None:
    with pytest.raises(ContractError, match="knows frames of recordings and not images"):
        SimulatedDepth().predict(Wall().frame(0).image)
    with pytest.raises(ContractError, match="knows frames of recordings and not images"):
        SimulatedDepth()(torch.zeros(1, 3, 8, 8))


def test_a_recording_without_truth_is_refused() -> None:
    class Blind(Wall):
        def depth(self, index):
            return None

    with pytest.raises(DataError, match="Frame 2 of 'wall' has no true depth"):
        SimulatedDepth().depth(Blind(), 2)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"scale_sigma": -0.1}, "depth.scale_sigma is -0.1"),
        ({"outliers": 1.0}, "depth.outliers is 1"),
        ({"own_length": "far"}, "depth.own_length"),
        ({"farthest": 0.1}, "depth.farthest is 0.1"),
        ({"scale_sgma": 0.1}, "depth.scale_sgma.*did you mean 'depth.scale_sigma'"),
    ],
)
def test_options_that_cannot_work_are_refused(options, match) -> None:
    with pytest.raises(ConfigError, match=match):
        make_depth("simulated", **options)
