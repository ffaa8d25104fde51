import threading
import time

import numpy as np
import pytest
from scipy.optimize import least_squares

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, log_se3
from prgbd.plugins.slam.orb_gtsam.optimisation import pose_optimisation
from prgbd.plugins.slam.orb_gtsam.optimisation.pose_optimisation import optimise_pose, solve_damped
from prgbd.plugins.slam.orb_gtsam.optimisation.reprojection import penalty
from tests.plugins.slam.orb_gtsam.scenes import CAMERA, numerical_jacobian, project

TRUE = exp_se3(np.array([0.1, -0.2, 0.05, 0.3, 0.1, 0.2]))
GUESS = exp_se3(np.array([0.02, 0.03, -0.02, 0.1, 0.2, -0.15])) @ TRUE


def view(count=300, noise=0.0, outliers=0.0, mono=0.3, seed=0):
    rng = np.random.default_rng(seed)
    inside = np.stack([rng.uniform(-3, 3, count), rng.uniform(-1, 1, count), rng.uniform(3, 12, count)], axis=1)
    xyz = (inside - TRUE[:3, 3]) @ TRUE[:3, :3]
    uvr = project(TRUE, xyz) + noise * rng.standard_normal((count, 3))
    bad = rng.random(count) < outliers
    uvr[bad, :2] += rng.uniform(20, 80, (int(bad.sum()), 2))
    uvr[rng.random(count) < mono, 2] = -1
    return xyz, uvr, np.ones(count), bad


@pytest.mark.parametrize("mono", [0.0, 0.5, 1.0])
def test_exact_observations_give_the_true_pose(mono):
    xyz, uvr, weight, _ = view(mono=mono)
    pose, inlier = optimise_pose(GUESS, xyz, uvr, weight, CAMERA)
    np.testing.assert_allclose(pose, TRUE, atol=1e-9)
    assert inlier.all()


@pytest.mark.parametrize("seed", range(4))
def test_outliers_are_found_and_do_not_pull(seed):
    xyz, uvr, weight, bad = view(noise=0.5, outliers=0.4, seed=seed)
    pose, inlier = optimise_pose(GUESS, xyz, uvr, weight, CAMERA)
    assert not (inlier & bad).any()
    assert inlier[~bad].mean() > 0.95
    assert np.abs(log_se3(pose @ np.linalg.inv(TRUE))).max() < 0.005


def test_the_optimum_is_that_of_an_independent_solver():
    xyz, uvr, weight, _ = view(noise=0.3, seed=5)
    weight = np.random.default_rng(1).uniform(0.3, 1.0, (len(weight), 2))
    pose, inlier = optimise_pose(GUESS, xyz, uvr, weight, CAMERA)

    def residuals(xi):
        error = (project(exp_se3(xi) @ TRUE, xyz) - uvr) * np.sqrt(weight)[:, [0, 0, 1]]
        error[uvr[:, 2] < 0, 2] = 0
        return error[inlier].ravel()

    best = least_squares(residuals, np.zeros(6), xtol=1e-14, ftol=1e-14).x
    np.testing.assert_allclose(pose, exp_se3(best) @ TRUE, atol=1e-5)


@pytest.mark.parametrize("mono", [0.0, 1.0])
@pytest.mark.parametrize("robust", [False, True])
def test_normal_equations_agree_with_finite_differences(mono, robust):
    xyz, uvr, _, _ = view(count=40, noise=3.0, mono=mono)
    weight = np.ones((40, 2))
    active = np.arange(40) % 5 > 0
    H, b = np.zeros((6, 6)), np.zeros(6)
    camera = np.array(CAMERA)
    pose_optimisation._normal_equations(GUESS, xyz, uvr, weight, camera, active, robust, H, b)

    def cost(xi):
        return np.array([0.5 * pose_optimisation._cost(exp_se3(xi) @ GUESS, xyz, uvr, weight, camera, active, robust)])

    gradient = numerical_jacobian(cost, 6)[0]
    np.testing.assert_allclose(-b, gradient, rtol=1e-5, atol=1e-4 * np.abs(gradient).max())
    if not robust:
        J = numerical_jacobian(lambda xi: project(exp_se3(xi) @ GUESS, xyz[active]).ravel(), 6).reshape(-1, 3, 6)
        J = J[:, : 2 if mono else 3].reshape(-1, 6)
        np.testing.assert_allclose(np.tril(H), np.tril(J.T @ J), rtol=1e-5, atol=1e-3 * np.abs(H).max() * 1e-3)


def test_a_guess_that_is_hundreds_of_pixels_off_converges():
    xyz, uvr, weight, _ = view()
    far = exp_se3(np.array([0.2, 0.3, -0.2, 0.3, 0.3, -0.4])) @ TRUE
    assert np.median(np.linalg.norm(project(far, xyz)[:, :2] - uvr[:, :2], axis=1)) > 200
    pose, _ = optimise_pose(far, xyz, uvr, weight, CAMERA)
    np.testing.assert_allclose(pose, TRUE, atol=1e-7)


def test_points_behind_the_camera_are_outliers():
    xyz, uvr, weight, _ = view()
    behind = np.array([0.5, 0.2, -4.0])
    xyz[:20] = (behind - TRUE[:3, 3]) @ TRUE[:3, :3]
    pose, inlier = optimise_pose(GUESS, xyz, uvr, weight, CAMERA)
    assert not inlier[:20].any()
    assert inlier[20:].all()
    np.testing.assert_allclose(pose, TRUE, atol=1e-7)


def test_unusable_input_leaves_the_guess_without_inliers():
    xyz, uvr, weight, _ = view()
    for few in (0, 2):
        pose, inlier = optimise_pose(GUESS, xyz[:few], uvr[:few], weight[:few], CAMERA)
        np.testing.assert_array_equal(pose, GUESS)
        assert inlier.shape == (few,)
        assert not inlier.any()
    pose, inlier = optimise_pose(GUESS, np.full_like(xyz, np.nan), uvr, weight, CAMERA)
    np.testing.assert_array_equal(pose, GUESS)
    assert not inlier.any()


def test_single_bad_numbers_do_not_spread():
    xyz, uvr, weight, _ = view()
    xyz[0, 1], uvr[1, 0], weight[2] = np.nan, np.inf, np.nan
    pose, inlier = optimise_pose(GUESS, xyz, uvr, weight, CAMERA)
    np.testing.assert_allclose(pose, TRUE, atol=1e-9)
    assert not inlier[:3].any()


def test_degenerate_points_give_a_finite_rigid_pose():
    xyz, uvr, weight, _ = view(mono=1.0)
    pose, _ = optimise_pose(GUESS, np.repeat(xyz[:1], 300, 0), np.repeat(uvr[:1], 300, 0), weight, CAMERA)
    assert np.isfinite(pose).all()
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)


def test_inputs_stay_as_they_are_and_any_layout_is_accepted():
    xyz, uvr, weight, _ = view(noise=0.5)
    guess, points = GUESS.copy(), xyz.copy()
    once, _ = optimise_pose(guess, points, uvr, weight, CAMERA)
    np.testing.assert_array_equal(guess, GUESS)
    np.testing.assert_array_equal(points, xyz)
    again, _ = optimise_pose(np.asfortranarray(guess), points[::1], uvr.astype(np.float64), weight, CAMERA)
    np.testing.assert_array_equal(once, again)


def test_the_kernel_is_hubers():
    assert penalty(3.0, False, True) == 3.0
    assert penalty(100.0, False, True) == pytest.approx(2 * np.sqrt(599.1) - 5.991)
    assert penalty(7.0, True, True) == 7.0
    assert penalty(100.0, True, False) == 100.0
    assert penalty(1e5, True, False) < penalty(np.inf, True, False) < np.inf


def test_damped_solver():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((6, 6))
    H, b, x = A @ A.T + np.eye(6), rng.standard_normal(6), np.zeros(6)
    assert solve_damped(np.tril(H), b, 0.1, np.zeros((6, 6)), x)
    np.testing.assert_allclose(x, np.linalg.solve(H + 0.1 * np.diag(np.diag(H)), b))
    assert not solve_damped(-np.eye(6), b, 0.0, np.zeros((6, 6)), x)


def test_the_interpreter_runs_meanwhile():
    xyz, uvr, weight, _ = view(noise=0.5)
    many = [np.tile(a, (1000, 1)) if a.ndim == 2 else np.tile(a, 1000) for a in (xyz, uvr, weight)]
    optimise_pose(GUESS, xyz, uvr, weight, CAMERA)
    worker = threading.Thread(target=optimise_pose, args=(GUESS, *many, CAMERA))
    gaps, last = [], time.perf_counter()
    worker.start()
    begin = last
    while worker.is_alive():
        time.sleep(0.001)
        gaps.append(time.perf_counter() - last)
        last = time.perf_counter()
    assert max(gaps) < 0.8 * (last - begin)


def test_a_wrong_depth_costs_the_depth_and_not_the_match():
    xyz, uvr, weight, _ = view(noise=0.3, mono=0.0, seed=3)
    wrong = np.random.default_rng(4).random(len(xyz)) < 0.4
    uvr[wrong, 2] -= 30.0
    _, without = optimise_pose(GUESS, xyz, uvr, weight, CAMERA)
    pose, inlier = optimise_pose(GUESS, xyz, uvr, weight, CAMERA, depth_fallback=True)
    assert without[wrong].mean() < 0.02
    assert inlier[wrong].mean() > 0.95
    assert np.abs(log_se3(pose @ np.linalg.inv(TRUE))).max() < 0.005
