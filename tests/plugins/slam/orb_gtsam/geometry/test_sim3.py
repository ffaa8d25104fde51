"""Similarities against known truth: closed form, RANSAC among wrong matches, refinement under noise."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.geometry import sim3 as sim
from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3

INTRINSICS = (400.0, 410.0, 320.0, 240.0)


def truth(scale: float) -> np.ndarray:
    pose = exp_se3(np.array([0.1, -0.2, 0.05, 0.4, -0.1, 0.3]))
    return sim.similarity(pose[:3, :3], pose[:3, 3], scale)


def pixels(xyz: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = INTRINSICS
    return np.stack([fx * xyz[:, 0] / xyz[:, 2] + cx, fy * xyz[:, 1] / xyz[:, 2] + cy], axis=1)


def correspondences(aSb: np.ndarray, n: int = 120, wrong: int = 0, noise: float = 0.0, depth_noise: float = 0.0):
    rng = np.random.default_rng(3)
    b = np.stack([rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(4, 12, n)], axis=1)
    a = b @ aSb[:3, :3].T + aSb[:3, 3]
    uv_a, uv_b = pixels(a) + noise * rng.standard_normal((n, 2)), pixels(b) + noise * rng.standard_normal((n, 2))
    swapped = rng.permutation(n)[:wrong]
    a[swapped], uv_a[swapped] = a[np.roll(swapped, 1)], uv_a[np.roll(swapped, 1)]
    a *= 1 + depth_noise * rng.standard_normal((n, 1))
    b *= 1 + depth_noise * rng.standard_normal((n, 1))
    right = np.ones(n, bool)
    right[swapped] = False
    return sim.Correspondences(a, b, uv_a, uv_b, np.ones(n), np.ones(n), INTRINSICS), right


@pytest.mark.parametrize("free", [True, False])
def test_closed_form_finds_the_truth(free: bool) -> None:
    aSb = truth(2.5 if free else 1.0)
    pairs, _ = correspondences(aSb)
    np.testing.assert_allclose(sim.align(pairs.xyz_a, pairs.xyz_b, free_scale=free), aSb, atol=1e-10)


def test_closed_form_makes_a_rotation_of_a_mirrored_scene() -> None:
    rng = np.random.default_rng(0)
    b = rng.normal(size=(20, 3))
    found = sim.align(b * [1, 1, -1], b, free_scale=False)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)


def test_inverse_and_scale() -> None:
    aSb = np.stack([truth(2.5), truth(0.3)])
    np.testing.assert_allclose(sim.invert(aSb) @ aSb, np.broadcast_to(np.eye(4), (2, 4, 4)), atol=1e-12)
    assert sim.scale_of(aSb[1]) == pytest.approx(0.3)


def test_ransac_separates_right_from_wrong() -> None:
    aSb = truth(1.7)
    pairs, right = correspondences(aSb, wrong=70)
    found = sim.ransac(pairs, np.random.default_rng(0), free_scale=True, least=20)
    assert found is not None
    np.testing.assert_allclose(found[0], aSb, atol=1e-6)
    assert (found[1] == right).mean() > 0.98


def test_ransac_with_fixed_scale_refuses_a_scaled_scene() -> None:
    pairs, _ = correspondences(truth(1.7))
    assert sim.ransac(pairs, np.random.default_rng(0), free_scale=False, least=60) is None


def test_ransac_refuses_noise_and_too_few() -> None:
    pairs, _ = correspondences(truth(1.0), wrong=120)
    assert sim.ransac(pairs, np.random.default_rng(0), free_scale=True, least=20) is None
    few, _ = correspondences(truth(1.0), n=19)
    assert sim.ransac(few, np.random.default_rng(0), free_scale=True, least=20) is None


def test_equal_seeds_give_equal_results() -> None:
    pairs, _ = correspondences(truth(1.7), wrong=60, noise=0.5)
    first, second = (sim.ransac(pairs, np.random.default_rng(5), free_scale=True, least=20) for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first[0], second[0])


def test_normal_equations_agree_with_finite_differences() -> None:
    aSb = truth(1.4)
    pairs, _ = correspondences(aSb, n=40, noise=2.0, depth_noise=0.2)  # beyond Huber's limit for some
    active = np.ones(40, bool)
    _, g = sim._normal_equations(pairs, aSb, active)

    def cost(xi: np.ndarray) -> float:
        moved = exp_se3(np.append(xi[:3], 0 * xi[3:6]))[:3, :3]
        return sim._cost(pairs, sim.similarity(moved, xi[3:6], np.exp(xi[6])) @ aSb, active)

    steps = 1e-6 * np.eye(7)
    numerical = np.array([(cost(s) - cost(-s)) / 2e-6 for s in steps])
    np.testing.assert_allclose(g, -0.5 * numerical, rtol=1e-4, atol=1e-3 * abs(g).max())


def test_scale_is_found_where_both_cameras_are_in_one_place() -> None:
    aSb = sim.similarity(exp_se3(np.array([0.02, 0.1, 0, 0, 0, 0]))[:3, :3], np.zeros(3), 1.8)
    pairs, _ = correspondences(aSb, noise=0.5, depth_noise=0.05)
    found, inlier = sim.refine(pairs, sim.similarity(np.eye(3), np.zeros(3), 1.5), np.ones(120, bool), free_scale=True)
    assert sim.scale_of(found) == pytest.approx(1.8, rel=0.02)
    assert inlier.mean() > 0.9


@pytest.mark.parametrize("free", [True, False])
def test_refinement_improves_on_the_closed_form_and_drops_outliers(free: bool) -> None:
    aSb = truth(1.7 if free else 1.0)
    pairs, right = correspondences(aSb, wrong=20, noise=0.5, depth_noise=0.02)
    closed = sim.align(pairs.xyz_a[right], pairs.xyz_b[right], free_scale=free)
    start = np.ones(len(right), bool)
    start[np.flatnonzero(~right)[:10]] = False
    found, inlier = sim.refine(pairs, closed, start, free_scale=free)
    assert np.abs(found - aSb).max() < np.abs(closed - aSb).max() + 1e-3
    assert np.abs(found - aSb).max() < 0.03
    assert not inlier[~right].any()
    assert inlier[right].mean() > 0.9
    if not free:
        assert sim.scale_of(found) == pytest.approx(1.0)
