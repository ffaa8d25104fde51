"""What every solver of bundle adjustment keeps to, and that all of them find the same."""

from dataclasses import fields, replace

import numpy as np
import pytest

from prgbd.core.errors import ConfigError, ContractError
from prgbd.plugins.slam.orb_gtsam.geometry.lie import log_se3
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleState
from prgbd.plugins.slam.orb_gtsam.optimisation.make_solver import SOLVERS, make_solver
from prgbd.plugins.slam.orb_gtsam.optimisation.solver import BundleSolver
from tests.plugins.slam.orb_gtsam.scenes import CAMERA, drive

MONO = (*CAMERA[:4], 0.0)


@pytest.fixture(params=sorted(SOLVERS))
def solver(request) -> BundleSolver:
    return make_solver(request.param)


def worst_pose_error(cTw, truth):
    return max(np.abs(log_se3(a @ np.linalg.inv(b))).max() for a, b in zip(cTw, truth, strict=True))


class TestLocally:
    """Two rounds, with outliers removed between them."""

    @pytest.mark.parametrize("mono", [0.0, 0.5, 1.0])
    def test_exact_observations_give_the_truth(self, solver, mono):
        scene = drive(mono=mono)
        result = solver.refine_locally(scene.problem, iterations=(10, 30))
        np.testing.assert_allclose(result.cTw, scene.cTw, atol=1e-5)
        stereo = np.bincount(scene.pt[scene.uvr[:, 2] >= 0], minlength=len(scene.xyz)) > 0
        placed = stereo | (np.bincount(scene.pt, minlength=len(scene.xyz)) > 3)
        np.testing.assert_allclose(result.xyz[placed], scene.xyz[placed], atol=1e-3)
        assert result.inlier.all()
        assert result.final_cost < 1e-3 < result.initial_cost

    @pytest.mark.parametrize("seed", range(3))
    def test_outliers_are_found_and_do_not_pull(self, solver, seed):
        scene = drive(noise=0.5, outliers=0.1, mono=0.3, seed=seed)
        clean = drive(noise=0.5, mono=0.3, seed=seed)
        result = solver.refine_locally(scene.problem)
        # A point that is seen once or twice can hide one wrong observation.
        often = np.bincount(scene.pt, minlength=len(scene.xyz))[scene.pt] > 3
        assert (result.inlier & scene.bad)[often].sum() <= 0.01 * scene.bad.sum()
        assert result.inlier[~scene.bad & often].mean() > 0.9
        with_outliers = worst_pose_error(result.cTw, scene.cTw)
        assert with_outliers < 0.03
        without = worst_pose_error(solver.refine_locally(clean.problem).cTw, clean.cTw)
        assert with_outliers < 3 * without + 0.005

    def test_the_kernel_is_what_withstands_outliers(self, solver):
        scene = drive(noise=0.5, outliers=0.1)
        robust = solver.refine_locally(scene.problem)
        plain = solver.refine_locally(scene.problem, robust=False)
        assert worst_pose_error(plain.cTw, scene.cTw) > 3 * worst_pose_error(robust.cTw, scene.cTw)

    def test_with_all_poses_fixed_only_points_move(self, solver):
        scene = drive()
        result = solver.refine_locally(replace(scene.problem, cTw=scene.cTw, fixed=np.ones(8, bool)))
        np.testing.assert_array_equal(result.cTw, scene.cTw)
        np.testing.assert_allclose(result.xyz[scene.pt], scene.xyz[scene.pt], atol=1e-4)

    def test_fixed_poses_and_the_problem_stay_as_they_are(self, solver):
        scene = drive(noise=0.5)
        problem = scene.problem
        before = [np.copy(getattr(problem, field.name)) for field in fields(problem)]
        result = solver.refine_locally(problem)
        for a, field in zip(before, fields(problem), strict=True):
            np.testing.assert_array_equal(a, getattr(problem, field.name))
        np.testing.assert_array_equal(result.cTw[:2], scene.cTw0[:2])
        assert np.abs(result.cTw[2:] - scene.cTw0[2:]).max() > 1e-3
        rotations = result.cTw[:, :3, :3]
        np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (8, 1, 1)), atol=1e-12)

    def test_the_order_of_observations_does_not_matter(self, solver):
        scene = drive(noise=0.5, outliers=0.05)
        shuffled = np.random.default_rng(3).permutation(len(scene.kf))
        a, b = solver.refine_locally(scene.problem), solver.refine_locally(scene.only(shuffled))
        np.testing.assert_allclose(a.cTw, b.cTw, atol=1e-6)
        np.testing.assert_array_equal(a.inlier[shuffled], b.inlier)

    def test_points_with_one_monocular_observation_do_no_harm(self, solver):
        scene = drive(noise=0.5)
        lonely = np.flatnonzero(np.isin(scene.pt, np.arange(100)))
        first = lonely[np.unique(scene.pt[lonely], return_index=True)[1]]
        scene.uvr[first, 2] = -1
        keep = np.setdiff1d(np.arange(len(scene.kf)), np.setdiff1d(lonely, first))
        result = solver.refine_locally(scene.only(keep))
        assert np.isfinite(result.cTw).all()
        assert np.abs(result.xyz - scene.xyz).max() < 5.0
        assert worst_pose_error(result.cTw, scene.cTw) < 0.02

    def test_degenerate_problems_stay_finite(self, solver):
        scene = drive(noise=0.5, mono=1.0)
        # Nothing fixed; a keyframe and a point that nothing observes; the same observation twice; points behind.
        scene.xyz0[:5, 2] = -10.0
        twice = np.r_[np.flatnonzero((scene.kf != 4) & (scene.pt != 9)), 0, 0]
        result = solver.refine_locally(replace(scene.only(twice), fixed=np.zeros(8, bool)))
        assert np.isfinite(result.cTw).all()
        assert np.isfinite(result.xyz).all()
        np.testing.assert_allclose(result.cTw[4], scene.cTw0[4], atol=1e-12)
        np.testing.assert_array_equal(result.xyz[9], scene.xyz0[9])
        for rows in (np.zeros(0, np.int64), np.arange(1)):
            result = solver.refine_locally(scene.only(rows))
            assert np.isfinite(result.cTw).all()
            assert result.inlier.shape == rows.shape

    def test_a_monocular_camera_ignores_right_coordinates(self, solver):
        scene = drive(noise=0.5)
        ignoring = solver.refine_locally(replace(scene.problem, camera=MONO))
        scene.uvr[:, 2] = -1
        told = solver.refine_locally(replace(scene.problem, camera=MONO))
        np.testing.assert_array_equal(ignoring.cTw, told.cTw)

    def test_bad_numbers_are_outliers(self, solver):
        scene = drive(noise=0.5)
        scene.uvr[3, 0], scene.inv_sigma2[4] = np.nan, np.inf
        result = solver.refine_locally(scene.problem)
        assert not result.inlier[[3, 4]].any()
        assert np.isfinite(result.cTw).all()
        assert np.isfinite(result.final_cost)

    def test_one_variance_and_the_same_for_both_parts_give_identical_results(self, solver):
        scene = drive(noise=0.5, outliers=0.05, mono=0.3)
        both = replace(scene.problem, inv_sigma2=np.stack([scene.inv_sigma2] * 2, axis=1))
        a, b = solver.refine_locally(scene.problem), solver.refine_locally(both)
        np.testing.assert_array_equal(a.cTw, b.cTw)
        np.testing.assert_array_equal(a.xyz, b.xyz)
        np.testing.assert_array_equal(a.inlier, b.inlier)

    def test_a_weak_right_column_counts_for_little_and_one_without_weight_for_nothing(self, solver):
        scene = drive(noise=0.2)
        scene.uvr[:, 2] += 8.0 * np.random.default_rng(3).standard_normal(len(scene.uvr))
        believed = solver.refine_locally(scene.problem)
        weights = np.stack([scene.inv_sigma2, np.full(len(scene.uvr), 1 / 64.0)], axis=1)
        doubted = solver.refine_locally(replace(scene.problem, inv_sigma2=weights))
        assert worst_pose_error(doubted.cTw, scene.cTw) < 0.75 * worst_pose_error(believed.cTw, scene.cTw)
        assert doubted.inlier.mean() > 0.95 > 0.5 > believed.inlier.mean()
        weights[:, 1] = 0.0
        none = solver.refine_locally(replace(scene.problem, inv_sigma2=weights))
        scene.uvr[:, 2] = -1.0
        np.testing.assert_array_equal(none.cTw, solver.refine_locally(scene.problem).cTw)

    def test_observations_with_a_wrong_depth_go_on_without_it(self, solver):
        scene = drive(noise=0.2)
        wrong = np.random.default_rng(4).random(len(scene.uvr)) < 0.2
        scene.uvr[wrong, 2] -= 25.0
        plain = solver.refine_locally(scene.problem)
        kept = solver.refine_locally(scene.problem, depth_fallback=True)
        assert not plain.depth_rejected.any()
        assert plain.inlier[wrong].mean() < 0.02
        assert kept.depth_rejected[wrong].mean() > 0.9
        assert kept.inlier[wrong].mean() > 0.9
        assert kept.depth_rejected[~wrong].mean() < 0.05


class TestGlobally:
    """One round over everything."""

    def test_exact_observations_give_the_truth(self, solver):
        scene = drive(mono=0.3)
        result = solver.refine_globally(scene.problem, iterations=50, tolerance=1e-12)
        np.testing.assert_allclose(result.cTw, scene.cTw, atol=1e-5)
        assert result.inlier.all()

    def test_ten_iterations_suffice_from_a_usual_start(self, solver):
        scene = drive(noise=0.5, outliers=0.05, seed=1)
        ten = solver.refine_globally(scene.problem)
        many = solver.refine_globally(scene.problem, iterations=100, tolerance=1e-9)
        assert ten.final_cost == pytest.approx(many.final_cost, rel=0.01)

    def test_under_constrained_landmarks_do_not_raise(self, solver):
        scene = drive(noise=0.5, mono=1.0)
        # Every third point keeps one observation; another two see the same point from the same place.
        order = np.argsort(scene.pt, kind="stable")
        first = order[np.unique(scene.pt[order], return_index=True)[1]]
        keep = np.setdiff1d(np.arange(len(scene.kf)), np.setdiff1d(np.flatnonzero(scene.pt % 3 == 0), first))
        scene.cTw0[3] = scene.cTw0[2]
        result = solver.refine_globally(replace(scene.only(keep), camera=(*CAMERA[:4], -1.0)))
        assert np.isfinite(result.cTw).all()
        assert np.isfinite(result.xyz).all()
        assert result.final_cost < 0.2 * result.initial_cost
        np.testing.assert_array_equal(result.cTw[:2], scene.cTw0[:2])

    def test_without_anything_fixed_or_observed_it_stays_finite(self, solver):
        scene = drive(noise=0.5)
        result = solver.refine_globally(replace(scene.problem, fixed=np.zeros(len(scene.cTw), bool)))
        assert np.isfinite(result.cTw).all()
        assert result.final_cost < 0.1 * result.initial_cost
        result = solver.refine_globally(scene.only(np.zeros(0, np.int64)))
        np.testing.assert_array_equal(result.cTw, scene.cTw0)
        # A keyframe that lost all its observations.
        result = solver.refine_globally(scene.only(np.flatnonzero(scene.kf != 5)))
        np.testing.assert_allclose(result.cTw[5], scene.cTw0[5], atol=1e-12)
        assert result.final_cost < 0.1 * result.initial_cost


def test_a_step_takes_only_the_active_observations(solver):
    scene = drive(noise=0.5)
    state = BundleState.of(scene.problem)
    active = state.usable & (state.pt != 7) & (state.kf != 6)
    solver.minimise(state, active, robust=True, iterations=5)
    np.testing.assert_array_equal(state.points[7], scene.xyz0[7])
    np.testing.assert_allclose(state.poses[6], scene.cTw0[6], atol=1e-12)
    assert worst_pose_error(state.poses[:6], scene.cTw[:6]) < 0.5 * worst_pose_error(scene.cTw0[:6], scene.cTw[:6])


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize(("mono", "weak"), [(0.0, False), (0.4, False), (1.0, False), (0.4, True)])
def test_all_solvers_reach_the_same_optimum(mono, weak, robust):
    scene = drive(noise=0.5, outliers=0.03 if robust else 0.0, mono=mono)
    if weak:
        share = np.random.default_rng(2).uniform(0.01, 1.0, len(scene.uvr))
        scene.inv_sigma2 = np.stack([scene.inv_sigma2, scene.inv_sigma2 * share], axis=1)
    common = {"iterations": 100, "robust": robust, "tolerance": 1e-9}
    ours, other = (make_solver(name).refine_globally(scene.problem, **common) for name in ("numba", "gtsam"))
    assert ours.final_cost < ours.initial_cost
    assert ours.initial_cost == other.initial_cost
    assert ours.final_cost == pytest.approx(other.final_cost, rel=1e-3)
    np.testing.assert_allclose(ours.cTw, other.cTw, atol=1e-4)
    assert np.mean(ours.inlier == other.inlier) > 0.995


def test_all_solvers_remove_the_same_outliers_and_depths():
    scene = drive(noise=0.5, outliers=0.05, mono=0.3)
    scene.uvr[(np.arange(len(scene.uvr)) % 9 == 0) & (scene.uvr[:, 2] > 0), 2] -= 25.0
    common = {"iterations": (50, 50), "depth_fallback": True, "tolerance": 1e-9}
    ours, other = (make_solver(name).refine_locally(scene.problem, **common) for name in ("numba", "gtsam"))
    assert ours.final_cost == pytest.approx(other.final_cost, rel=1e-2)
    np.testing.assert_allclose(ours.cTw, other.cTw, atol=1e-3)
    assert np.mean(ours.inlier == other.inlier) > 0.995
    assert np.mean(ours.depth_rejected == other.depth_rejected) > 0.995


def test_problems_that_do_not_hold_together_are_refused():
    scene = drive()
    scene.pt[0] = len(scene.xyz)
    with pytest.raises(ContractError, match="not there"):
        _ = scene.problem
    scene.xyz0[0, 0] = np.nan
    with pytest.raises(ContractError, match="not finite"):
        _ = scene.problem


def test_an_unknown_solver_is_named():
    with pytest.raises(ConfigError, match="'ceres'; choose gtsam or numba"):
        make_solver("ceres")
