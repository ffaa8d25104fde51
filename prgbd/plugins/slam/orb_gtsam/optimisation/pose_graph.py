"""Pose graph optimisation: spread what a loop closure found out over the trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from prgbd.core.errors import ContractError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Standard deviation (radians, units of the map, log of scale) of what holds the graph in place.
_TIGHT = 1e-6
# Probability with which a true loop edge must pass for one.
_INLIER_PROBABILITY = 0.99
# Most rejected loop edges that are tried again, and iterations of each: a true one converges fast, a false one never.
_HEARINGS, _HEARING_ITERATIONS = 20, 10


@dataclass(frozen=True)
class PoseGraphEdges:
    """Measured relative poses.

    Attributes:
        i: (E,) row of the first pose of every edge.
        j: (E,) row of the second pose.
        iTj: (E, 4, 4) measured pose of j seen from i, in the units of i.
        sigmas: Standard deviations (E,), or (E, 6) as three rotations in radians and three translations, or (E, 7)
            with the log of scale for Sim(3); or information matrices (E, 6, 6) or (E, 7, 7) in that order. Those of
            robust edges must be honest.
        scales: (E,) measured scale: a point p of camera j lies at ``scale * R p + t`` in camera i. None for SE(3).
        robust: (E,) bool, edges that may be wrong; none by default.

    Raises:
        ContractError: If columns have different lengths, are not finite, or a scale is not positive.
    """

    i: IntArray
    j: IntArray
    iTj: FloatArray
    sigmas: FloatArray
    scales: FloatArray | None = None
    robust: BoolArray | None = None

    def __post_init__(self) -> None:
        measured = [self.iTj, self.sigmas] + ([] if self.scales is None else [self.scales])
        if any(len(column) != len(self.i) for column in (self.j, *measured)):
            raise ContractError("A pose graph was given columns of different lengths; they need one row per edge.")
        finite = all(np.isfinite(column).all() for column in measured)
        if not finite or (self.scales is not None and not np.all(self.scales > 0)):
            raise ContractError("A pose graph was given poses, sigmas or scales that are not finite or not positive.")

    def __len__(self) -> int:
        """Return the number of edges."""
        return len(self.i)


def optimise_pose_graph(
    wTc: FloatArray, edges: PoseGraphEdges, *, fixed: int = 0, iterations: int = 50
) -> tuple[FloatArray, FloatArray]:
    """Find the poses that agree best with relative poses, in SE(3), or in Sim(3) where scale drifts.

    Edges marked robust are weighed by graduated non-convexity with truncated least squares (Yang et al., "Graduated
    Non-Convexity for Robust Spatial Perception", RA-L 2020): unlike a fixed kernel, it lets a true loop pull a
    far-drifted trajectory together and yet drops a false one.

    Args:
        wTc: (K, 4, 4) first guess.
        edges: Relative poses; in Sim(3) if they have scales.
        fixed: The pose that stays.
        iterations: Most Levenberg-Marquardt iterations (of each weighting, where there are robust edges).

    Returns:
        The poses (K, 4, 4) and scales (K,), the scale of ``fixed`` being 1. A point p of camera k lies at
        ``scale[k] * R p + t`` in the world, so a point of the old map moves by ``wSc_new @ inverse(wTc_old)``. Scales
        are 1 without ``edges.scales``. Poses that no edge joins to ``fixed`` keep their place as a whole.

    Raises:
        ContractError: If poses are not finite, or an edge or ``fixed`` names one that does not exist.
    """
    poses = np.array(wTc, np.float64)
    _check(poses, edges, fixed)
    if len(edges) == 0 or len(poses) < 2:
        return poses, np.ones(len(poses))
    similar = edges.scales is not None
    graph, values = _edge_factors(edges), gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, _similarity(pose, 1.0) if similar else gtsam.Pose3(pose))
    tight = gtsam.noiseModel.Isotropic.Sigma(7 if similar else 6, _TIGHT)
    for k in _anchors(edges.i, edges.j, len(poses), fixed):
        if similar:
            graph.add(gtsam.PriorFactorSimilarity3(k, values.atSimilarity3(k), tight))
        else:
            graph.add(gtsam.PriorFactorPose3(k, values.atPose3(k), tight))
    doubtful = np.zeros(0, np.int64) if edges.robust is None else np.flatnonzero(edges.robust)
    return _read(_solve(graph, values, doubtful, iterations), poses, fixed, similar=similar)


def _check(poses: FloatArray, edges: PoseGraphEdges, fixed: int) -> None:
    ends = np.concatenate([edges.i, edges.j])
    if len(ends) and (ends.min() < 0 or ends.max() >= len(poses)):
        raise ContractError("A pose graph was given an edge between poses that do not exist.")
    if len(poses) and not 0 <= fixed < len(poses):
        raise ContractError(f"A pose graph was told to hold pose {fixed}, but it has {len(poses)} poses.")
    if not np.isfinite(poses).all():
        raise ContractError("A pose graph was given poses, sigmas or scales that are not finite or not positive.")


def _edge_factors(edges: PoseGraphEdges) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for e, (i, j) in enumerate(zip(edges.i.tolist(), edges.j.tolist(), strict=True)):
        if edges.scales is None:
            noise = _noise(edges.sigmas[e], 6)
            graph.add(gtsam.BetweenFactorPose3(i, j, gtsam.Pose3(edges.iTj[e]), noise))
        else:
            noise = _noise(edges.sigmas[e], 7)
            measured = _similarity(edges.iTj[e], float(edges.scales[e]))
            graph.add(gtsam.BetweenFactorSimilarity3(i, j, measured, noise))
    return graph


def _noise(spread: FloatArray, dimension: int) -> gtsam.noiseModel.Base:
    if spread.ndim == 2:
        return gtsam.noiseModel.Gaussian.Information(spread)
    return gtsam.noiseModel.Diagonal.Sigmas(np.broadcast_to(spread, (dimension,)).copy())


def _similarity(pose: FloatArray, scale: float) -> gtsam.Similarity3:
    """Return ``p -> scale * R p + t``; GTSAM means ``scale * (R p + t)`` by the same three."""
    return gtsam.Similarity3(gtsam.Rot3(pose[:3, :3]), pose[:3, 3] / scale, scale)


def _anchors(first: IntArray, second: IntArray, count: int, fixed: int) -> list[int]:
    """Return one pose of every connected part of the graph: ``fixed``, and the lowest of each part without it."""
    joined = coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    _, part = connected_components(joined, directed=False)
    lowest = np.unique(part, return_index=True)[1]
    return [fixed] + [int(k) for k in lowest if part[k] != part[fixed]]


def _solve(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, doubtful: IntArray, iterations: int
) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setOrderingType("COLAMD")
    parameters.setLinearSolverType("MULTIFRONTAL_CHOLESKY")
    if len(doubtful) == 0:
        return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    graduated = gtsam.GncLMParams(parameters)
    graduated.setLossType(gtsam.GncLossType.TLS)
    # The linear schedule drops true loops together with false ones far more often.
    graduated.setScheduler(gtsam.GncScheduler.SuperLinear)
    sure = np.setdiff1d(np.arange(graph.size()), doubtful)
    graduated.setKnownInliers(sure.tolist())
    optimizer = gtsam.GncLMOptimizer(graph, values, graduated)
    optimizer.setInlierCostThresholdsAtProbability(_INLIER_PROBABILITY)
    solved = optimizer.optimize()
    trusted = optimizer.getWeights()[doubtful] > 0.5
    if trusted.all():
        return solved
    kept = gtsam.NonlinearFactorGraph()
    for e in [*sure.tolist(), *doubtful[trusted].tolist()]:
        kept.add(graph.at(e))
    return _readmit(kept, solved, [graph.at(e) for e in doubtful[~trusted].tolist()], parameters)


def _readmit(
    graph: gtsam.NonlinearFactorGraph,
    solved: gtsam.Values,
    rejected: list[gtsam.NonlinearFactor],
    parameters: gtsam.LevenbergMarquardtParams,
) -> gtsam.Values:
    """Give rejected edges a second hearing, one by one, as false ones may have taken true ones down with them.

    An edge is admitted if the graph can bend to it at no more cost than chance explains (as in Latif et al., "Robust
    loop closing over time for pose graph SLAM", IJRR 2013).
    """
    cost = graph.error(solved)
    parameters.setMaxIterations(_HEARING_ITERATIONS)
    for factor in rejected[:: -(-len(rejected) // _HEARINGS)]:
        trial = graph.clone()
        trial.add(factor)
        candidate = gtsam.LevenbergMarquardtOptimizer(trial, solved, parameters).optimize()
        rise = trial.error(candidate) - cost
        if rise <= 0.5 * chi2.ppf(_INLIER_PROBABILITY, factor.dim()):
            graph, solved, cost = trial, candidate, cost + rise
    return solved


def _read(solved: gtsam.Values, poses: FloatArray, fixed: int, *, similar: bool) -> tuple[FloatArray, FloatArray]:
    """Return poses and scales, or the first guess if the solution is not finite."""
    result, scale = poses.copy(), np.ones(len(poses))
    for k in range(len(poses)):
        if k == fixed:
            continue
        if similar:
            value = solved.atSimilarity3(k)
            scale[k] = value.scale()
            result[k, :3, :3] = value.rotation().matrix()
            result[k, :3, 3] = value.translation() * scale[k]
        else:
            result[k] = solved.atPose3(k).matrix()
    if np.isfinite(result).all() and np.isfinite(scale).all() and np.all(scale > 0):
        return result, scale
    return poses, np.ones(len(poses))
