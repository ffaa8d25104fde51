import numpy as np
import pytest

from prgbd.core.errors import ContractError
from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, log_se3
from prgbd.plugins.slam.orb_gtsam.optimisation import schur
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_adjustment import local_bundle_adjustment
from prgbd.plugins.slam.orb_gtsam.optimisation.reprojection import linearise, split_weights
from prgbd.plugins.slam.orb_gtsam.optimisation.sparse_cholesky import envelope, solve_envelope
from tests.plugins.slam.orb_gtsam.scenes import CAMERA, drive, numerical_jacobian, project

POSE = exp_se3(np.array([0.1, -0.2, 0.05, 0.3, 0.1, 0.2]))
POINT = np.array([1.0, 0.5, 6.0])


def worst_pose_error(cTw, truth):
    return max(np.abs(log_se3(a @ np.linalg.inv(b))).max() for a, b in zip(cTw, truth, strict=True))


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


@pytest.mark.parametrize("mono", [0.0, 0.5, 1.0])
def test_exact_observations_give_the_truth(mono):
    scene = drive(mono=mono)
    result = local_bundle_adjustment(*scene.problem, iterations=(10, 30))
    np.testing.assert_allclose(result.cTw, scene.cTw, atol=1e-7)
    stereo = np.bincount(scene.pt[scene.uvr[:, 2] >= 0], minlength=len(scene.xyz)) > 0
    placed = stereo | (np.bincount(scene.pt, minlength=len(scene.xyz)) > 3)
    np.testing.assert_allclose(result.xyz[placed], scene.xyz[placed], atol=1e-4)
    assert result.inlier.all()
    assert result.final_cost < 1e-9 < result.initial_cost


@pytest.mark.parametrize("seed", range(3))
def test_outliers_are_found_and_do_not_pull(seed):
    scene = drive(noise=0.5, outliers=0.1, mono=0.3, seed=seed)
    clean = drive(noise=0.5, mono=0.3, seed=seed)
    result = local_bundle_adjustment(*scene.problem)
    # A point that is seen once or twice can hide one wrong observation.
    often = np.bincount(scene.pt, minlength=len(scene.xyz))[scene.pt] > 3
    assert (result.inlier & scene.bad)[often].sum() <= 0.01 * scene.bad.sum()
    assert result.inlier[~scene.bad & often].mean() > 0.9
    with_outliers = worst_pose_error(result.cTw, scene.cTw)
    assert with_outliers < 0.03
    assert with_outliers < 3 * worst_pose_error(local_bundle_adjustment(*clean.problem).cTw, clean.cTw) + 0.005


def test_the_kernel_is_what_withstands_outliers():
    scene = drive(noise=0.5, outliers=0.1)
    robust = local_bundle_adjustment(*scene.problem)
    plain = local_bundle_adjustment(*scene.problem, robust=False)
    assert worst_pose_error(plain.cTw, scene.cTw) > 3 * worst_pose_error(robust.cTw, scene.cTw)


def test_with_all_poses_fixed_only_points_move():
    scene = drive()
    result = local_bundle_adjustment(scene.cTw, np.ones(8, bool), *scene.problem[2:])
    np.testing.assert_array_equal(result.cTw, scene.cTw)
    np.testing.assert_allclose(result.xyz[scene.pt], scene.xyz[scene.pt], atol=1e-6)


def test_fixed_poses_and_inputs_stay_as_they_are():
    scene = drive(noise=0.5)
    before = [np.copy(a) for a in scene.problem[:7]]
    result = local_bundle_adjustment(*scene.problem)
    for a, b in zip(before, scene.problem[:7], strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(result.cTw[:2], scene.cTw0[:2])
    assert np.abs(result.cTw[2:] - scene.cTw0[2:]).max() > 1e-3
    rotations = result.cTw[:, :3, :3]
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (8, 1, 1)), atol=1e-12)


def test_the_order_of_observations_does_not_matter():
    scene = drive(noise=0.5, outliers=0.05)
    shuffled = np.random.default_rng(3).permutation(len(scene.kf))
    a = local_bundle_adjustment(*scene.problem)
    columns = [scene.kf[shuffled], scene.pt[shuffled], scene.uvr[shuffled], scene.inv_sigma2[shuffled]]
    b = local_bundle_adjustment(scene.cTw0, scene.fixed, scene.xyz0, *columns, *CAMERA)
    np.testing.assert_allclose(a.cTw, b.cTw, atol=1e-6)
    np.testing.assert_array_equal(a.inlier[shuffled], b.inlier)


def test_points_with_one_monocular_observation_do_no_harm():
    scene = drive(noise=0.5)
    lonely = np.flatnonzero(np.isin(scene.pt, np.arange(100)))
    first = lonely[np.unique(scene.pt[lonely], return_index=True)[1]]
    keep = np.setdiff1d(np.arange(len(scene.kf)), np.setdiff1d(lonely, first))
    scene.uvr[first, 2] = -1
    columns = [scene.kf[keep], scene.pt[keep], scene.uvr[keep], scene.inv_sigma2[keep]]
    result = local_bundle_adjustment(scene.cTw0, scene.fixed, scene.xyz0, *columns, *CAMERA)
    assert np.isfinite(result.cTw).all()
    assert np.abs(result.xyz - scene.xyz).max() < 5.0
    assert worst_pose_error(result.cTw, scene.cTw) < 0.02


def test_degenerate_problems_stay_finite():
    scene = drive(noise=0.5, mono=1.0)
    # Nothing fixed; a keyframe and a point that nothing observes; the same observation twice; points behind.
    scene.xyz0[:5, 2] = -10.0
    twice = np.r_[np.flatnonzero((scene.kf != 4) & (scene.pt != 9)), 0, 0]
    columns = [scene.kf[twice], scene.pt[twice], scene.uvr[twice], scene.inv_sigma2[twice]]
    result = local_bundle_adjustment(scene.cTw0, np.zeros(8, bool), scene.xyz0, *columns, *CAMERA)
    assert np.isfinite(result.cTw).all()
    assert np.isfinite(result.xyz).all()
    np.testing.assert_allclose(result.cTw[4], scene.cTw0[4], atol=1e-12)
    np.testing.assert_array_equal(result.xyz[9], scene.xyz0[9])
    for rows in (np.zeros(0, np.int64), np.arange(1)):
        few = [scene.kf[rows], scene.pt[rows], scene.uvr[rows], scene.inv_sigma2[rows]]
        result = local_bundle_adjustment(scene.cTw0, scene.fixed, scene.xyz0, *few, *CAMERA)
        assert np.isfinite(result.cTw).all()
        assert result.inlier.shape == rows.shape


def test_a_monocular_camera_ignores_right_coordinates():
    scene = drive(noise=0.5)
    mono = (*CAMERA[:4], 0.0)
    ignoring = local_bundle_adjustment(*scene.problem[:7], *mono)
    scene.uvr[:, 2] = -1
    told = local_bundle_adjustment(*scene.problem[:7], *mono)
    np.testing.assert_array_equal(ignoring.cTw, told.cTw)


def test_bad_numbers_are_outliers_and_bad_maps_are_refused():
    scene = drive(noise=0.5)
    scene.uvr[3, 0], scene.inv_sigma2[4] = np.nan, np.inf
    result = local_bundle_adjustment(*scene.problem)
    assert not result.inlier[[3, 4]].any()
    assert np.isfinite(result.cTw).all()
    assert np.isfinite(result.final_cost)
    scene.pt[0] = len(scene.xyz)
    with pytest.raises(ContractError, match="not there"):
        local_bundle_adjustment(*scene.problem)
    scene.xyz0[0, 0] = np.nan
    with pytest.raises(ContractError, match="not finite"):
        local_bundle_adjustment(*scene.problem)


def test_one_variance_and_the_same_for_both_parts_give_identical_results():
    scene = drive(noise=0.5, outliers=0.05, mono=0.3)
    both = [*scene.problem]
    both[6] = np.stack([scene.inv_sigma2] * 2, axis=1)
    a, b = local_bundle_adjustment(*scene.problem), local_bundle_adjustment(*both)
    np.testing.assert_array_equal(a.cTw, b.cTw)
    np.testing.assert_array_equal(a.xyz, b.xyz)
    np.testing.assert_array_equal(a.inlier, b.inlier)


def test_a_weak_right_column_counts_for_little_and_one_without_weight_for_nothing():
    scene = drive(noise=0.2)
    scene.uvr[:, 2] += 8.0 * np.random.default_rng(3).standard_normal(len(scene.uvr))
    believed = local_bundle_adjustment(*scene.problem)
    weights = np.stack([scene.inv_sigma2, np.full(len(scene.uvr), 1 / 64.0)], axis=1)
    doubted = local_bundle_adjustment(*scene.problem[:6], weights, *CAMERA)
    assert worst_pose_error(doubted.cTw, scene.cTw) < 0.75 * worst_pose_error(believed.cTw, scene.cTw)
    assert doubted.inlier.mean() > 0.95 > 0.5 > believed.inlier.mean()
    weights[:, 1] = 0.0
    none = local_bundle_adjustment(*scene.problem[:6], weights, *CAMERA)
    mono = scene.uvr.copy()
    mono[:, 2] = -1.0
    expected = local_bundle_adjustment(*scene.problem[:5], mono, scene.inv_sigma2, *CAMERA)
    np.testing.assert_array_equal(none.cTw, expected.cTw)


def test_observations_with_a_wrong_depth_go_on_without_it():
    scene = drive(noise=0.2)
    wrong = np.random.default_rng(4).random(len(scene.uvr)) < 0.2
    scene.uvr[wrong, 2] -= 25.0
    plain = local_bundle_adjustment(*scene.problem)
    kept = local_bundle_adjustment(*scene.problem, depth_fallback=True)
    assert not plain.depth_rejected.any()
    assert plain.inlier[wrong].mean() < 0.02
    assert kept.depth_rejected[wrong].mean() > 0.9
    assert kept.inlier[wrong].mean() > 0.9
    assert kept.depth_rejected[~wrong].mean() < 0.05
