"""Bundle adjustment by GTSAM's factor graphs."""

from __future__ import annotations

import gtsam
import numpy as np

from prgbd.plugins.slam.orb_gtsam.camera.chi_square import CHI2_MONO, CHI2_STEREO
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BoolArray, BundleState, FloatArray, IntArray
from prgbd.plugins.slam.orb_gtsam.optimisation.solver import TOLERANCE, BundleSolver

# Standard deviation, in radians and units of the map, that holds a fixed pose: GTSAM's NonlinearEquality would make
# some of its optimisers return the start unchanged.
_TIGHT = 1e-6
# Standard deviation of the prior that keeps an under-constrained point near its place, in distances from the camera.
_WEAK = 10.0


class GtsamSolver(BundleSolver):
    """Orders and factorises sparsely, which pays for long trajectories with loops.

    It holds the interpreter's lock while it works, and building the graph takes longer than the compiled solver needs
    for all of a local adjustment.
    """

    def minimise(
        self, state: BundleState, active: BoolArray, *, robust: bool, iterations: int, tolerance: float = TOLERANCE
    ) -> None:
        """See ``BundleSolver.minimise``."""
        if not active.any():
            return
        wTc, seen = inverse(state.poses), np.unique(state.pt[active])
        values, graph = _values(state, wTc, seen), _graph(state, wTc, active, robust)
        try:
            solved = _solve(graph, values, iterations, tolerance)
        except RuntimeError as error:
            # IndeterminantLinearSystemException reaches Python as a RuntimeError.
            if "ndetermina" not in str(error):
                raise
            _hold_points(graph, state, wTc, seen)
            solved = _solve(graph, values, iterations, tolerance)
        _take(solved, state, seen)


def _values(state: BundleState, wTc: FloatArray, seen: IntArray) -> gtsam.Values:
    """Return the first guess: poses by their row, and behind them the points ``seen``."""
    values = gtsam.Values()
    for k, pose in enumerate(wTc):
        values.insert(k, gtsam.Pose3(pose))
    for q in seen.tolist():
        values.insert(len(wTc) + q, state.points[q])
    return values


def _take(solved: gtsam.Values, state: BundleState, seen: IntArray) -> None:
    """Write a solution into the state; what is not finite is no solution."""
    poses, points = state.poses.copy(), state.points.copy()
    moving = np.flatnonzero(state.column >= 0)
    if len(moving):
        poses[moving] = inverse(np.stack([solved.atPose3(int(k)).matrix() for k in moving]))
    for q in seen.tolist():
        points[q] = solved.atPoint3(len(poses) + q)
    if np.isfinite(poses).all() and np.isfinite(points).all():
        state.poses[:], state.points[:] = poses, points


def _graph(state: BundleState, wTc: FloatArray, active: BoolArray, robust: bool) -> gtsam.NonlinearFactorGraph:
    """Return reprojection factors, tight priors on fixed poses and weak ones on points that one view cannot place."""
    graph = gtsam.NonlinearFactorGraph()
    _add_observations(graph, state, active, robust)
    tight = gtsam.noiseModel.Isotropic.Sigma(6, _TIGHT)
    for k in np.flatnonzero(state.column < 0).tolist():
        graph.add(gtsam.PriorFactorPose3(k, gtsam.Pose3(wTc[k]), tight))
    views = np.bincount(state.pt[active], minlength=len(state.points))
    depths = np.bincount(state.pt[active & (state.uvr[:, 2] >= 0)], minlength=len(state.points))
    _hold_points(graph, state, wTc, np.flatnonzero((views == 1) & (depths == 0)))
    return graph


def _add_observations(graph: gtsam.NonlinearFactorGraph, state: BundleState, active: BoolArray, robust: bool) -> None:
    fx, fy, cx, cy, bf = state.camera.tolist()
    mono_camera = gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)
    stereo_camera = gtsam.Cal3_S2Stereo(fx, fy, 0.0, cx, cy, max(bf, 0.0) / fx)
    noises: dict[tuple[float, float], gtsam.noiseModel.Base] = {}
    rows = zip(
        state.kf[active].tolist(),
        (state.pt[active] + len(state.poses)).tolist(),
        state.uvr[active].tolist(),
        state.weight[active].tolist(),
        strict=True,
    )
    for kf, pt, (u, v, u_right), (weight, accuracy) in rows:
        accuracy = accuracy if u_right >= 0 else 0.0
        noise = noises.get((weight, accuracy))
        if noise is None:
            noise = noises[weight, accuracy] = _noise(weight, accuracy, robust)
        if u_right >= 0:
            point = gtsam.StereoPoint2(u, u_right, v)
            graph.add(gtsam.GenericStereoFactor3D(point, noise, kf, pt, stereo_camera))
        else:
            graph.add(gtsam.GenericProjectionFactorCal3_S2(np.array([u, v]), noise, kf, pt, mono_camera))


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


def _hold_points(graph: gtsam.NonlinearFactorGraph, state: BundleState, wTc: FloatArray, rows: IntArray) -> None:
    """Add weak priors on points, scaled by their distance from the first camera that sees them."""
    for q in rows.tolist():
        camera = wTc[state.kf[state.first[q]], :3, 3]
        distance = max(float(np.linalg.norm(state.points[q] - camera)), 1e-6)
        noise = gtsam.noiseModel.Isotropic.Sigma(3, _WEAK * distance)
        graph.add(gtsam.PriorFactorPoint3(len(state.poses) + q, state.points[q], noise))


def _solve(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int, tolerance: float) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(tolerance)
    parameters.setOrderingType("COLAMD")
    parameters.setLinearSolverType("MULTIFRONTAL_CHOLESKY")
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
