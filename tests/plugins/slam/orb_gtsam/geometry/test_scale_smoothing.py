"""Drift of a map and wander of a network, told apart by what geometry knows."""

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.geometry.scale_smoothing import split_scale

COUNT = 120


def random_walk(step: float) -> np.ndarray:
    """Return the covariance of a drift that grows by ``step`` from keyframe to keyframe."""
    at = np.arange(COUNT)
    return step**2 * np.minimum(at[:, None], at).astype(float)


def wander(rng: np.random.Generator, sigma: float, length: float) -> np.ndarray:
    decay = np.exp(-1 / length)
    out = np.zeros(COUNT)
    out[0] = sigma * rng.standard_normal()
    for k in range(1, COUNT):
        out[k] = decay * out[k - 1] + sigma * np.sqrt(1 - decay**2) * rng.standard_normal()
    return out


@pytest.mark.parametrize("seed", range(5))
def test_a_stiff_map_stays_whatever_the_network_says(seed) -> None:
    split = split_scale(wander(np.random.default_rng(seed), 0.2, 20), random_walk(1e-3))
    assert np.ptp(split.drift) < 0.01
    assert split.sigma >= 0.1


@pytest.mark.parametrize("seed", range(5))
def test_a_loose_map_follows_a_network_that_hardly_wanders(seed) -> None:
    rng = np.random.default_rng(seed)
    drift = np.cumsum(0.03 * rng.standard_normal(COUNT))
    split = split_scale(1.5 + drift + wander(rng, 0.03, 10), random_walk(0.03))
    np.testing.assert_allclose(split.drift - 1.5, drift, atol=0.12)
    assert np.std(split.drift - drift) < 0.04, "the wander, and what is white of the drift, is all that is left"


def test_wander_averages_out_and_the_rest_is_drift() -> None:
    rng = np.random.default_rng(3)
    drift = np.linspace(0, 1.0, COUNT)
    split = split_scale(drift + wander(rng, 0.1, 8), random_walk(0.03))
    assert np.std(split.drift - drift) < 0.07


def test_the_unit_of_the_network_comes_in_whole() -> None:
    split = split_scale(np.full(COUNT, 0.7), random_walk(1e-4))
    np.testing.assert_allclose(split.drift, 0.7, atol=1e-3)


def test_unknown_keyframes_are_filled_in_from_their_neighbours() -> None:
    ratio = np.linspace(0, 1, COUNT)
    ratio[40:60] = np.nan
    split = split_scale(ratio, random_walk(0.05))
    np.testing.assert_allclose(split.drift[40:60], np.linspace(0, 1, COUNT)[40:60], atol=0.05)
    assert np.isfinite(split_scale(np.full(5, np.nan), np.eye(5)).drift).all()


@pytest.mark.parametrize("size", [1e4, 1e12, 1e30])
def test_a_scale_that_geometry_leaves_quite_open_follows_the_network(size) -> None:
    rng = np.random.default_rng(0)
    loose = size * random_walk(1.0) + size * 1e-9 * rng.standard_normal((COUNT, COUNT))
    drift = np.linspace(0, 2, COUNT)
    split = split_scale(drift, 0.5 * (loose + loose.T))
    np.testing.assert_allclose(split.drift, drift, atol=0.1)
