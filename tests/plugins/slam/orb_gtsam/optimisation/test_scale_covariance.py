"""What geometry leaves uncertain about scale, against the scatter of bundle adjustments of noisy pixels."""

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleProblem
from prgbd.plugins.slam.orb_gtsam.optimisation.numba_solver import NumbaSolver
from prgbd.plugins.slam.orb_gtsam.optimisation.scale_covariance import ScaleCovariance

CAMERA = (300.0, 300.0, 160.0, 120.0, 0.0)
POSES, SIGHT = 24, 7.0


def corridor(sigma: float, seed: int) -> tuple[BundleProblem, np.ndarray]:
    """Return a camera that moves ahead past points, each seen while it is near, and the true depths."""
    world, noise = np.random.default_rng(0), np.random.default_rng(seed)
    xyz = np.stack([*world.uniform(-3, 3, (2, 700)), world.uniform(2, POSES * 0.5 + SIGHT, 700)], axis=1)
    cTw = np.tile(np.eye(4), (POSES, 1, 1))
    cTw[:, 2, 3] = -0.5 * np.arange(POSES)
    z = xyz[:, 2] + cTw[:, 2, 3, None]
    uv = np.stack([300 * xyz[:, 0] / z + 160, 300 * xyz[:, 1] / z + 120], axis=2)
    inside = (z > 1) & (z < SIGHT) & (uv > 0).all(axis=2) & (uv < (320, 240)).all(axis=2)
    inside &= inside.sum(axis=0) >= 3
    kept = np.flatnonzero(inside.any(axis=0))
    pose, point = np.nonzero(inside[:, kept])
    seen = uv[:, kept][pose, point] + sigma * noise.standard_normal((len(pose), 2))
    problem = BundleProblem(
        cTw=cTw,
        fixed=np.arange(POSES) < 2,
        xyz=xyz[kept],
        pose_row=pose,
        point_row=point,
        uvr=np.column_stack([seen, np.full(len(pose), -1.0)]),
        inv_sigma2=np.full(len(pose), sigma**-2),
        camera=CAMERA,
    )
    return problem, z[:, kept][pose, point]


def test_the_scatter_of_adjusted_maps_is_foretold() -> None:
    sigma, scales = 0.5, []
    for seed in range(40):
        problem, true = corridor(sigma, seed)
        found = NumbaSolver().refine_globally(problem, iterations=15)
        z = np.einsum("nj,nj->n", found.cTw[problem.pose_row, 2, :3], found.xyz[problem.point_row])
        error = np.log((z + found.cTw[problem.pose_row, 2, 3]) / true)
        count = np.bincount(problem.pose_row)
        scales.append(np.bincount(problem.pose_row, error) / count)
    change = np.array(scales)[:, -1] - np.array(scales)[:, 4]
    covariance = ScaleCovariance(problem).of(np.ones(len(true)), np.arange(POSES))
    foretold = np.sqrt(covariance[-1, -1] + covariance[4, 4] - 2 * covariance[-1, 4])
    assert foretold == pytest.approx(np.std(change), rel=0.4)


def test_it_grows_along_the_way_and_with_the_noise() -> None:
    def change(sigma: float, to: int) -> float:
        problem, true = corridor(sigma, 1)
        found = ScaleCovariance(problem).of(np.ones(len(true)), np.array([3, to]))
        return float(np.sqrt(found[0, 0] + found[1, 1] - 2 * found[0, 1]))

    assert change(0.5, 8) < change(0.5, 14) < change(0.5, 22)
    assert change(1.0, 22) == pytest.approx(2 * change(0.5, 22), rel=0.1)


def test_near_points_are_known_best() -> None:
    problem, true = corridor(0.5, 1)
    variance = ScaleCovariance(problem).depth_variance
    assert np.median(variance[true < 3]) < 0.8 * np.median(variance[true > 5])
