"""The pose of one camera from known points: motion-only bundle adjustment with outlier rejection."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.geometry.lie import compose_into, exp_se3_into, orthonormalise
from prgbd.plugins.slam.orb_gtsam.kernels import FAST, kernel
from prgbd.plugins.slam.orb_gtsam.optimisation.reprojection import (
    CHI2_MONO,
    CHI2_STEREO,
    chi2_of,
    keep_monocular,
    linearise,
    penalty,
    split_weights,
)

FloatArray = NDArray[np.float64]

_ROUNDS = 4
_ITERATIONS = 10
# Relative decrease of the cost at which a round has converged.
_CONVERGED = 1e-5


def optimise_pose(
    cTw0: FloatArray,
    xyz: FloatArray,
    uvr: FloatArray,
    inv_sigma2: FloatArray,
    camera: tuple[float, float, float, float, float],
    depth_fallback: bool = False,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Refine a camera pose on observations of known points, as ORB-SLAM2's ``PoseOptimization``.

    Four rounds of at most ten Levenberg-Marquardt iterations; after each, observations are sorted anew into inliers
    and outliers (chi-square 5.991 monocular, 7.815 stereo, positive depth). The Huber kernel is dropped in the last
    round. A round starts where the last one ended.

    Args:
        cTw0: (4, 4) first guess, world to camera.
        xyz: (N, 3) points in the world.
        uvr: (N, 3) observed ``(u, v, u_right)`` in pixels; ``u_right < 0`` for monocular observations.
        inv_sigma2: (N,) inverse variance of ``(u, v, u_right)``, or (N, 2) of ``(u, v)`` and of ``u_right``; 1 / px^2.
        camera: ``(fx, fy, cx, cy, bf)`` in pixels; ``bf``, baseline times ``fx``, is unused where all observations are
            monocular.
        depth_fallback: Whether observations that only their depth makes outliers count, without it, as monocular
            inliers.

    Returns:
        The pose (4, 4) and which observations (N,) are inliers. Fewer than three usable observations leave the first
        guess as it is, without inliers.
    """
    cTw = np.array(cTw0, np.float64, order="C")
    inlier = np.zeros(len(xyz), np.bool_)
    _optimise(
        cTw,
        np.ascontiguousarray(xyz, np.float64),
        np.ascontiguousarray(uvr, np.float64),
        split_weights(inv_sigma2),
        np.array(camera, np.float64),
        depth_fallback,
        inlier,
    )
    return cTw, inlier


@kernel(fastmath=FAST, forceinline=True)
def _cost(
    pose: FloatArray,
    xyz: FloatArray,
    uvr: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    active: NDArray[np.bool_],
    robust: bool,
) -> float:
    total = 0.0
    for k in range(len(xyz)):
        if not active[k]:
            continue
        chi2 = chi2_of(pose, xyz[k], uvr[k], weight[k], camera)
        total += penalty(chi2, uvr[k, 2] >= 0.0, robust)
    return total


@kernel(fastmath=FAST, forceinline=True)
def _normal_equations(
    pose: FloatArray,
    xyz: FloatArray,
    uvr: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    active: NDArray[np.bool_],
    robust: bool,
    H: FloatArray,
    b: FloatArray,
) -> None:
    """Fill ``H`` and ``b`` of ``H xi = b`` for the left update ``exp(xi) cTw``."""
    H[:] = 0.0
    b[:] = 0.0
    G, e = np.empty((3, 6)), np.empty(3)
    for k in range(len(xyz)):
        w = linearise(pose, xyz[k], uvr[k], weight[k], camera, robust, G, e) if active[k] else 0.0
        if w == 0.0:
            continue
        for i in range(6):
            w0, w1, w2 = w * G[0, i], w * G[1, i], w * G[2, i]
            b[i] += w0 * e[0] + w1 * e[1] + w2 * e[2]
            for j in range(6):
                H[i, j] += w0 * G[0, j] + w1 * G[1, j] + w2 * G[2, j]


@kernel()
def solve_damped(H: FloatArray, b: FloatArray, damping: float, L: FloatArray, x: FloatArray) -> bool:
    """Solve ``(H + damping diag(H)) x = b`` by Cholesky from H's lower triangle; False if not positive definite."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            s = H[i, j]
            if i == j:
                s += damping * s + 1e-12
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                L[i, i] = math.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True


@kernel()
def _optimise(
    pose: FloatArray,
    xyz: FloatArray,
    measured: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    depth_fallback: bool,
    inlier: NDArray[np.bool_],
) -> None:
    n = len(xyz)
    # Rejected depths are taken out of this copy, and get another chance in every round.
    uvr = measured.copy()
    usable = np.empty(n, np.bool_)
    count = 0
    for k in range(n):
        total = weight[k, 0] + weight[k, 1]
        for j in range(3):
            total += xyz[k, j] + measured[k, j]
        usable[k] = math.isfinite(total)
        inlier[k] = usable[k]
        count += usable[k]
    H, L = np.zeros((6, 6)), np.zeros((6, 6))
    b, xi = np.zeros(6), np.zeros(6)
    delta, trial = np.zeros((4, 4)), np.zeros((4, 4))
    for outer in range(_ROUNDS):
        if count < 3:
            break
        robust = outer < _ROUNDS - 1
        damping = 1e-5
        cost = _cost(pose, xyz, uvr, weight, camera, inlier, robust)
        for _ in range(_ITERATIONS):
            _normal_equations(pose, xyz, uvr, weight, camera, inlier, robust, H, b)
            before = cost
            for _ in range(8):
                if solve_damped(H, b, damping, L, xi):
                    exp_se3_into(xi, delta)
                    compose_into(delta, pose, trial)
                    reached = _cost(trial, xyz, uvr, weight, camera, inlier, robust)
                    if reached < cost:
                        cost = reached
                        # Element by element: numba compiles seconds of error messages into a slice assignment.
                        for i in range(3):
                            for j in range(4):
                                pose[i, j] = trial[i, j]
                        damping = max(damping * 0.1, 1e-10)
                        break
                    if reached - cost <= _CONVERGED * cost:
                        break
                damping *= 10.0
            if not before - cost > _CONVERGED * before + 1e-12:
                break
        orthonormalise(pose)
        count = 0
        for k in range(n):
            if depth_fallback and usable[k]:
                uvr[k, 2] = measured[k, 2]
                keep_monocular(pose, xyz[k], uvr[k], weight[k], camera)
            limit = CHI2_STEREO if uvr[k, 2] >= 0.0 else CHI2_MONO
            inlier[k] = usable[k] and chi2_of(pose, xyz[k], uvr[k], weight[k], camera) <= limit
            count += inlier[k]
    if count < 3:
        inlier[:] = False
