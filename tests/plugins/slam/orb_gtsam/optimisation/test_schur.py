"""The compiled core of bundle adjustment against finite differences and dense algebra."""

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3
from prgbd.plugins.slam.orb_gtsam.optimisation import schur
from prgbd.plugins.slam.orb_gtsam.optimisation.reprojection import linearise, split_weights
from prgbd.plugins.slam.orb_gtsam.optimisation.sparse_cholesky import envelope, solve_envelope
from tests.plugins.slam.orb_gtsam.scenes import CAMERA, drive, numerical_jacobian, project

POSE = exp_se3(np.array([0.1, -0.2, 0.05, 0.3, 0.1, 0.2]))
POINT = np.array([1.0, 0.5, 6.0])


@pytest.mark.parametrize("accuracy", [1.0, 0.2])
@pytest.mark.parametrize("mono", [False, True])
def test_derivatives_agree_with_finite_differences(mono, accuracy):
    observed = project(POSE, POINT[None])[0] + [3.0, -2.0, 1.0]
    if mono:
        observed[2] = -1.0
    G, e = np.ones((3, 6)), np.ones(3)
    weight = linearise(POSE, POINT, observed, np.array([0.5, accuracy]), np.array(CAMERA), False, G, e)
    G[2], e[2] = G[2] / accuracy, e[2] / accuracy
    A = G[:, 3:] @ POSE[:3, :3]
    rows = 2 if mono else 3
    by_pose = numerical_jacobian(lambda xi: project(exp_se3(xi) @ POSE, POINT[None])[0], 6)
    by_point = numerical_jacobian(lambda d: project(POSE, (POINT + d)[None])[0], 3)
    assert weight == 0.5
    np.testing.assert_allclose(G[:rows], by_pose[:rows], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(A[:rows], by_point[:rows], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(e[:rows], (observed - project(POSE, POINT[None])[0])[:rows], atol=1e-9)
    assert not np.any(np.r_[A[rows:].ravel(), G[rows:].ravel(), e[rows:]])


@pytest.mark.parametrize("accuracy", [1.0, 0.2])
def test_the_huber_weight_is_the_derivative_of_the_cost(accuracy):
    observed = project(POSE, POINT[None])[0] + [9.0, -7.0, 5.0]
    G, e = np.ones((3, 6)), np.ones(3)
    row = np.array([0.5, accuracy])
    weight = linearise(POSE, POINT, observed, row, np.array(CAMERA), True, G, e)

    def cost(xi):
        one = np.zeros(1, np.int64)
        problem = (np.stack([exp_se3(xi) @ POSE]), POINT[None], one, one, observed[None], row[None])
        return np.array([schur.total_cost(*problem, np.array(CAMERA), np.ones(1, np.bool_), True)])

    assert weight < 0.5
    np.testing.assert_allclose(-weight * G.T @ e, numerical_jacobian(cost, 6)[0], rtol=1e-6)


def test_the_envelope_solver_agrees_with_a_dense_one():
    rng = np.random.default_rng(0)
    n = 24
    start = np.array([max(0, i - i % 6 - 6 * int(rng.integers(0, 3))) for i in range(n) if i % 6 == 0]).repeat(6)
    lower = np.tril(rng.standard_normal((n, n))) * (np.arange(n)[None] >= start[:, None])
    dense = lower @ lower.T + 5 * np.eye(n)
    dense *= (np.arange(n)[None] >= start[:, None]) | (np.arange(n)[:, None] >= start[None])
    dense = np.where(np.tri(n, dtype=bool), dense, dense.T) + 30 * np.eye(n)
    offset, size = np.zeros(n, np.int64), 0
    for i in range(n):
        offset[i] = size - start[i]
        size += i + 1 - start[i]
    S, b = np.zeros(size), rng.standard_normal(n)
    for i in range(n):
        S[offset[i] + start[i] : offset[i] + i + 1] = dense[i, start[i] : i + 1]
    x = b.copy()
    assert solve_envelope(S, offset, start, x)
    np.testing.assert_allclose(x, np.linalg.solve(dense, b), rtol=1e-9)
    assert not solve_envelope(-np.abs(S), offset, start, x)


def test_a_step_solves_the_full_normal_equations():
    scene = drive(keyframes=4, points=30, noise=1.0, mono=0.3)
    camera, order = np.array(CAMERA), np.argsort(scene.pt, kind="stable")
    kf, pt, uvr, weight = scene.kf[order], scene.pt[order], scene.uvr[order], split_weights(scene.inv_sigma2[order])
    weight[:, 1] = np.random.default_rng(1).uniform(0.1, 1.0, len(weight))
    P, free = 30, 2
    column = np.array([-1, -1, 0, 1])
    active = np.ones(len(kf), np.bool_)
    J, r = np.zeros((3 * len(kf), 6 * free + 3 * P)), np.zeros(3 * len(kf))
    for m in range(len(kf)):
        G, e, pose = np.zeros((3, 6)), np.zeros(3), scene.cTw0[kf[m]]
        w = linearise(pose, scene.xyz0[pt[m]], uvr[m], weight[m], camera, False, G, e)
        A = G[:, 3:] @ pose[:3, :3]
        J[3 * m : 3 * m + 3, 6 * free + 3 * pt[m] : 6 * free + 3 * pt[m] + 3] = A * w**0.5
        if column[kf[m]] >= 0:
            J[3 * m : 3 * m + 3, 6 * column[kf[m]] : 6 * column[kf[m]] + 6] = G * w**0.5
        r[3 * m : 3 * m + 3] = e * w**0.5
    H = J.T @ J
    damping = 1e-3
    seen = np.unique(pt)
    used = np.r_[np.arange(6 * free), (6 * free + 3 * seen[:, None] + np.arange(3)).ravel()]
    step = np.zeros(len(H))
    step[used] = np.linalg.solve((H + damping * np.diag(np.diag(H)))[np.ix_(used, used)], (J.T @ r)[used])

    first = np.searchsorted(pt, np.arange(P + 1))
    offset, start = np.zeros(12, np.int64), np.zeros(12, np.int64)
    S, b = np.empty(envelope(column, free, kf, first, offset, start)), np.empty(12)
    U, V, W = np.empty((free, 6, 6)), np.empty((P, 3, 3)), np.empty((len(kf), 3, 6))
    bu, bv = np.empty((free, 6)), np.empty((P, 3))
    problem = (scene.cTw0, scene.xyz0, column, kf, pt, uvr, weight, camera, active, False)
    schur.normal_equations(*problem, U, V, W, bu, bv)
    schur.reduce_to_poses(column, kf, first, damping, U, V, W, bu, bv, offset, S, b)
    assert solve_envelope(S, offset, start, b)
    np.testing.assert_allclose(b, step[: 6 * free], rtol=1e-5, atol=1e-8)
    poses, points = scene.cTw0.copy(), scene.xyz0.copy()
    schur.apply_step(scene.cTw0, scene.xyz0, column, kf, first, damping, V, W, bv, b, poses, points)
    np.testing.assert_allclose((points - scene.xyz0).ravel(), step[6 * free :], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(poses[3], exp_se3(step[6:12]) @ scene.cTw0[3], atol=1e-7)
