"""Bundle adjustment of a whole map, by GTSAM or by the compiled Schur-complement solver."""

from __future__ import annotations

from typing import Literal

import gtsam
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError
from prgbd.plugins.slam.orb_gtsam.camera.chi_square import CHI2_MONO, CHI2_STEREO
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_adjustment import TOLERANCE, BundleProblem, BundleResult

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Standard deviation, in radians and units of the map, that holds a fixed pose: GTSAM's NonlinearEquality would make
# some of its optimisers return the start unchanged.
_TIGHT = 1e-6
# Standard deviation of the prior that keeps an under-constrained point near its place, in distances from the camera.
_WEAK = 10.0


def full_bundle_adjustment(
    cTw: FloatArray,
    fixed: BoolArray,
    xyz: FloatArray,
    obs_kf: IntArray,
    obs_pt: IntArray,
    uvr: FloatArray,
    inv_sigma2: FloatArray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    bf: float,
    iterations: int = 10,
    backend: Literal["gtsam", "numba"] = "gtsam",
    robust: bool = True,
    tolerance: float = TOLERANCE,
) -> BundleResult:
    """Refine all keyframes and points together, as ORB-SLAM2's ``GlobalBundleAdjustemnt``.

    GTSAM orders and factorises sparsely, which pays for long trajectories with loops; it holds the interpreter's lock
    while it works. The numba solver does not, and is faster for a few hundred keyframes.

    Args:
        cTw: (K, 4, 4) poses, world to camera.
        fixed: (K,) bool, poses that hold the others in place.
        xyz: (P, 3) points in the world.
        obs_kf: (M,) row of the pose of every observation.
        obs_pt: (M,) row of its point.
        uvr: (M, 3) ``(u, v, u_right)`` in pixels; ``u_right < 0`` for monocular observations.
        inv_sigma2: (M,) inverse variance of ``(u, v, u_right)``, or (M, 2) of ``(u, v)`` and of ``u_right``; 1 / px^2.
        fx: Focal length in pixels.
        fy: Focal length in pixels.
        cx: Principal point in pixels.
        cy: Principal point in pixels.
        bf: Baseline times ``fx``; not positive for a monocular camera.
        iterations: Most Levenberg-Marquardt iterations.
        backend: ``gtsam`` or ``numba``.
        robust: Whether to apply a Huber kernel.
        tolerance: Relative decrease of the cost at which the adjustment has converged.

    Returns:
        Refined poses and points, all finite; fixed poses exactly as they came.

    Raises:
        ConfigError: If there is no such backend.
        ContractError: If poses or points are not finite, or an observation names a row that does not exist.
    """
    if backend not in ("gtsam", "numba"):
        raise ConfigError(f"Unknown bundle adjustment backend '{backend}'; choose gtsam or numba.")
    problem = BundleProblem.build(cTw, fixed, xyz, obs_kf, obs_pt, uvr, inv_sigma2, (fx, fy, cx, cy, bf))
    initial_cost = problem.cost(robust)
    if backend == "numba":
        problem.minimise(problem.usable, robust, iterations, tolerance)
    elif problem.usable.any():
        _minimise_with_gtsam(problem, robust, iterations, tolerance)
    return problem.result(initial_cost, robust)


def _minimise_with_gtsam(problem: BundleProblem, robust: bool, iterations: int, tolerance: float) -> None:
    """Refine the problem in place; what GTSAM cannot improve stays."""
    count = len(problem.poses)
    seen = np.unique(problem.pt[problem.usable])
    wTc = inverse(problem.poses)
    values = gtsam.Values()
    for k in range(count):
        values.insert(k, gtsam.Pose3(wTc[k]))
    for q in seen.tolist():
        values.insert(count + q, problem.points[q])
    graph = _graph(problem, wTc, robust)
    try:
        solved = _solve(graph, values, iterations, tolerance)
    except RuntimeError as error:
        # IndeterminantLinearSystemException reaches Python as a RuntimeError.
        if "ndetermina" not in str(error):
            raise
        _hold_points(graph, problem, wTc, seen)
        solved = _solve(graph, values, iterations, tolerance)
    poses, points = problem.poses.copy(), problem.points.copy()
    moving = np.flatnonzero(problem.column >= 0)
    if len(moving):
        poses[moving] = inverse(np.stack([solved.atPose3(int(k)).matrix() for k in moving]))
    for q in seen.tolist():
        points[q] = solved.atPoint3(count + q)
    if np.isfinite(poses).all() and np.isfinite(points).all():
        problem.poses[:], problem.points[:] = poses, points


def _graph(problem: BundleProblem, wTc: FloatArray, robust: bool) -> gtsam.NonlinearFactorGraph:
    """Return reprojection factors, tight priors on fixed poses and weak ones on points that one view cannot place."""
    fx, fy, cx, cy, bf = problem.camera.tolist()
    mono_camera = gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)
    stereo_camera = gtsam.Cal3_S2Stereo(fx, fy, 0.0, cx, cy, max(bf, 0.0) / fx)
    count = len(problem.poses)
    graph = gtsam.NonlinearFactorGraph()
    noises: dict[tuple[float, float], gtsam.noiseModel.Base] = {}
    stereo = problem.uvr[:, 2] >= 0
    rows = zip(
        problem.kf.tolist(),
        (problem.pt + count).tolist(),
        problem.uvr.tolist(),
        problem.weight.tolist(),
        stereo.tolist(),
        problem.usable.tolist(),
        strict=True,
    )
    for kf, pt, (u, v, ur), (weight, accuracy), is_stereo, usable in rows:
        if not usable:
            continue
        accuracy = accuracy if is_stereo else 0.0
        noise = noises.get((weight, accuracy))
        if noise is None:
            noise = noises[weight, accuracy] = _noise(weight, accuracy, robust)
        if is_stereo:
            point = gtsam.StereoPoint2(u, ur, v)
            graph.add(gtsam.GenericStereoFactor3D(point, noise, kf, pt, stereo_camera))
        else:
            graph.add(gtsam.GenericProjectionFactorCal3_S2(np.array([u, v]), noise, kf, pt, mono_camera))
    tight = gtsam.noiseModel.Isotropic.Sigma(6, _TIGHT)
    for k in np.flatnonzero(problem.column < 0).tolist():
        graph.add(gtsam.PriorFactorPose3(k, gtsam.Pose3(wTc[k]), tight))
    views = np.bincount(problem.pt[problem.usable], minlength=len(problem.points))
    depths = np.bincount(problem.pt[problem.usable & stereo], minlength=len(problem.points))
    _hold_points(graph, problem, wTc, np.flatnonzero((views == 1) & (depths == 0)))
    return graph


def _noise(weight: float, accuracy: float, robust: bool) -> gtsam.noiseModel.Base:
    """Return the noise of ``(u, u_right, v)``, the order of GTSAM, or of ``(u, v)`` where ``accuracy`` is 0."""
    sigma = weight**-0.5
    if accuracy > 0:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma, sigma / accuracy, sigma]))
    else:
        noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
    if not robust:
        return noise
    kernel = gtsam.noiseModel.mEstimator.Huber.Create((CHI2_STEREO if accuracy > 0 else CHI2_MONO) ** 0.5)
    return gtsam.noiseModel.Robust.Create(kernel, noise)


def _hold_points(graph: gtsam.NonlinearFactorGraph, problem: BundleProblem, wTc: FloatArray, rows: IntArray) -> None:
    """Add weak priors on points, scaled by their distance from the first camera that sees them."""
    for q in rows.tolist():
        camera = wTc[problem.kf[problem.first[q]], :3, 3]
        distance = max(float(np.linalg.norm(problem.points[q] - camera)), 1e-6)
        noise = gtsam.noiseModel.Isotropic.Sigma(3, _WEAK * distance)
        graph.add(gtsam.PriorFactorPoint3(len(problem.poses) + q, problem.points[q], noise))


def _solve(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int, tolerance: float) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(tolerance)
    parameters.setOrderingType("COLAMD")
    parameters.setLinearSolverType("MULTIFRONTAL_CHOLESKY")
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
