import numpy as np
import pytest

from prgbd.core.errors import ConfigError
from prgbd.plugins.slam.orb_gtsam.optimisation.full_bundle_adjustment import full_bundle_adjustment
from tests.plugins.slam.orb_gtsam.scenes import CAMERA, drive


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize(("mono", "weak"), [(0.0, False), (0.4, False), (1.0, False), (0.4, True)])
def test_gtsam_and_the_compiled_solver_reach_the_same_optimum(mono, weak, robust):
    scene = drive(noise=0.5, outliers=0.03 if robust else 0.0, mono=mono)
    problem = [*scene.problem]
    if weak:
        share = np.random.default_rng(2).uniform(0.01, 1.0, len(scene.uvr))
        problem[6] = np.stack([scene.inv_sigma2, scene.inv_sigma2 * share], axis=1)
    common = {"iterations": 100, "robust": robust, "tolerance": 1e-9}
    ours = full_bundle_adjustment(*problem, backend="numba", **common)
    gtsam = full_bundle_adjustment(*problem, backend="gtsam", **common)
    assert ours.final_cost < ours.initial_cost
    assert ours.initial_cost == gtsam.initial_cost
    assert ours.final_cost == pytest.approx(gtsam.final_cost, rel=1e-3)
    np.testing.assert_allclose(ours.cTw, gtsam.cTw, atol=1e-4)
    assert np.mean(ours.inlier == gtsam.inlier) > 0.995


@pytest.mark.parametrize("backend", ["gtsam", "numba"])
def test_exact_observations_give_the_truth(backend):
    scene = drive(mono=0.3)
    result = full_bundle_adjustment(*scene.problem, iterations=50, backend=backend, tolerance=1e-12)
    np.testing.assert_allclose(result.cTw, scene.cTw, atol=1e-5)
    assert result.inlier.all()


@pytest.mark.parametrize("backend", ["gtsam", "numba"])
def test_ten_iterations_suffice_from_a_usual_start(backend):
    scene = drive(noise=0.5, outliers=0.05, seed=1)
    ten = full_bundle_adjustment(*scene.problem, backend=backend)
    many = full_bundle_adjustment(*scene.problem, backend=backend, iterations=100, tolerance=1e-9)
    assert ten.final_cost == pytest.approx(many.final_cost, rel=0.01)


@pytest.mark.parametrize("backend", ["gtsam", "numba"])
def test_under_constrained_landmarks_do_not_raise(backend):
    scene = drive(noise=0.5, mono=1.0)
    # Every third point keeps one observation; another two see the same point from the same place.
    order = np.argsort(scene.pt, kind="stable")
    first = order[np.unique(scene.pt[order], return_index=True)[1]]
    keep = np.setdiff1d(np.arange(len(scene.kf)), np.setdiff1d(np.flatnonzero(scene.pt % 3 == 0), first))
    columns = [scene.kf[keep], scene.pt[keep], scene.uvr[keep], scene.inv_sigma2[keep]]
    camera = (*CAMERA[:4], -1.0)
    poses = scene.cTw0.copy()
    poses[3] = poses[2]
    result = full_bundle_adjustment(poses, scene.fixed, scene.xyz0, *columns, *camera, backend=backend)
    assert np.isfinite(result.cTw).all()
    assert np.isfinite(result.xyz).all()
    assert result.final_cost < 0.2 * result.initial_cost
    np.testing.assert_array_equal(result.cTw[:2], scene.cTw0[:2])


@pytest.mark.parametrize("backend", ["gtsam", "numba"])
def test_without_anything_fixed_or_observed_it_stays_finite(backend):
    scene = drive(noise=0.5)
    free = np.zeros(len(scene.cTw), bool)
    result = full_bundle_adjustment(scene.cTw0, free, *scene.problem[2:], backend=backend)
    assert np.isfinite(result.cTw).all()
    assert result.final_cost < 0.1 * result.initial_cost
    nothing = [scene.kf[:0], scene.pt[:0], scene.uvr[:0], scene.inv_sigma2[:0]]
    result = full_bundle_adjustment(scene.cTw0, scene.fixed, scene.xyz0, *nothing, *CAMERA, backend=backend)
    np.testing.assert_array_equal(result.cTw, scene.cTw0)
    # A keyframe that lost all its observations.
    seen = scene.kf != 5
    columns = [scene.kf[seen], scene.pt[seen], scene.uvr[seen], scene.inv_sigma2[seen]]
    result = full_bundle_adjustment(scene.cTw0, scene.fixed, scene.xyz0, *columns, *CAMERA, backend=backend)
    np.testing.assert_allclose(result.cTw[5], scene.cTw0[5], atol=1e-12)
    assert result.final_cost < 0.1 * result.initial_cost


def test_an_unknown_backend_is_named():
    scene = drive()
    with pytest.raises(ConfigError, match="ceres"):
        full_bundle_adjustment(*scene.problem, backend="ceres")
