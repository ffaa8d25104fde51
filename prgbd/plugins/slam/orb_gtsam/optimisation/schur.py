"""The compiled core of bundle adjustment: normal equations, Schur complement and Levenberg-Marquardt.

Points are eliminated, and the remaining system of poses is kept by rows from their first nonzero block on (an
envelope), so it stays small for cameras in temporal order however long the trajectory.
"""

from __future__ import annotations

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
)
from prgbd.plugins.slam.orb_gtsam.optimisation.sparse_cholesky import envelope, solve_envelope

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@kernel(forceinline=True)
def total_cost(
    poses: FloatArray,
    points: FloatArray,
    kf: IntArray,
    pt: IntArray,
    uvr: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    active: BoolArray,
    robust: bool,
) -> float:
    """Return half the sum of (Huber's rho of) the chi-squares of the active observations."""
    total = 0.0
    for m in range(len(kf)):
        if active[m]:
            chi2 = chi2_of(poses[kf[m]], points[pt[m]], uvr[m], weight[m], camera)
            total += penalty(chi2, uvr[m, 2] >= 0.0, robust)
    return 0.5 * total


@kernel()
def classify(
    poses: FloatArray,
    points: FloatArray,
    kf: IntArray,
    pt: IntArray,
    uvr: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    usable: BoolArray,
    inlier: BoolArray,
) -> None:
    """Mark as inliers the usable observations with positive depth and a chi-square below the 95 % limit."""
    for m in range(len(kf)):
        limit = CHI2_STEREO if uvr[m, 2] >= 0.0 else CHI2_MONO
        inlier[m] = usable[m] and chi2_of(poses[kf[m]], points[pt[m]], uvr[m], weight[m], camera) <= limit


@kernel()
def reject_depths(
    poses: FloatArray,
    points: FloatArray,
    kf: IntArray,
    pt: IntArray,
    uvr: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    usable: BoolArray,
    rejected: BoolArray,
) -> None:
    """Make monocular, in ``uvr``, the usable observations that only their depth makes outliers; mark them."""
    for m in range(len(kf)):
        if usable[m] and keep_monocular(poses[kf[m]], points[pt[m]], uvr[m], weight[m], camera):
            rejected[m] = True


@kernel(fastmath=FAST, forceinline=True)
def normal_equations(
    poses: FloatArray,
    points: FloatArray,
    column: IntArray,
    kf: IntArray,
    pt: IntArray,
    uvr: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    active: BoolArray,
    robust: bool,
    U: FloatArray,
    V: FloatArray,
    W: FloatArray,
    bu: FloatArray,
    bv: FloatArray,
) -> None:
    """Fill the blocks of the normal equations: ``U`` (F, 6, 6), ``V`` (P, 3, 3), ``W`` (M, 3, 6) and right sides.

    ``column`` (K,) is the number of a free pose among the free ones, or -1 for a fixed one; ``weight`` (M, 2) is as
    from ``split_weights``.
    """
    U[:] = 0.0
    V[:] = 0.0
    bu[:] = 0.0
    bv[:] = 0.0
    A, G, e = np.empty((3, 3)), np.empty((3, 6)), np.empty(3)
    for m in range(len(kf)):
        f, q, pose = column[kf[m]], pt[m], poses[kf[m]]
        w = linearise(pose, points[q], uvr[m], weight[m], camera, robust, G, e) if active[m] else 0.0
        if w == 0.0:
            W[m] = 0.0
            continue
        for r in range(3):
            for j in range(3):
                A[r, j] = G[r, 3] * pose[0, j] + G[r, 4] * pose[1, j] + G[r, 5] * pose[2, j]
        for i in range(3):
            w0, w1, w2 = w * A[0, i], w * A[1, i], w * A[2, i]
            bv[q, i] += w0 * e[0] + w1 * e[1] + w2 * e[2]
            for j in range(3):
                V[q, i, j] += w0 * A[0, j] + w1 * A[1, j] + w2 * A[2, j]
        if f < 0:
            continue
        for i in range(6):
            w0, w1, w2 = w * G[0, i], w * G[1, i], w * G[2, i]
            bu[f, i] += w0 * e[0] + w1 * e[1] + w2 * e[2]
            for j in range(i + 1):
                U[f, i, j] += w0 * G[0, j] + w1 * G[1, j] + w2 * G[2, j]
            for j in range(3):
                W[m, j, i] = w0 * A[0, j] + w1 * A[1, j] + w2 * A[2, j]


@kernel(fastmath=FAST, forceinline=True)
def invert_point_block(V: FloatArray, damping: float, out: FloatArray) -> None:
    """Invert a damped symmetric (3, 3) block; a direction that nothing observes gets a tiny weight, so it stays put."""
    trace = V[0, 0] + V[1, 1] + V[2, 2]
    floor = 1e-9 * trace + 1e-30
    a, d, f = V[0, 0] * (1 + damping) + floor, V[1, 1] * (1 + damping) + floor, V[2, 2] * (1 + damping) + floor
    b, c, e = V[0, 1], V[0, 2], V[1, 2]
    out[0, 0], out[0, 1], out[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    out[1, 1], out[1, 2], out[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    scale = 1.0 / (a * out[0, 0] + b * out[0, 1] + c * out[0, 2])
    for i in range(3):
        for j in range(i, 3):
            out[i, j] *= scale
            out[j, i] = out[i, j]


@kernel(fastmath=FAST, forceinline=True)
def reduce_to_poses(
    column: IntArray,
    kf: IntArray,
    first: IntArray,
    damping: float,
    U: FloatArray,
    V: FloatArray,
    W: FloatArray,
    bu: FloatArray,
    bv: FloatArray,
    offset: IntArray,
    S: FloatArray,
    b: FloatArray,
) -> None:
    """Eliminate the points: fill the envelope ``S`` and the right side ``b`` of the reduced system.

    Element (i, j) of the system is ``S[offset[i] + j]``. Observations are sorted by point; those of point q are
    ``first[q]:first[q + 1]``.
    """
    S[:] = 0.0
    for f in range(len(U)):
        for i in range(6):
            row = 6 * f + i
            b[row] = bu[f, i]
            for j in range(i + 1):
                S[offset[row] + 6 * f + j] = U[f, i, j]
            # A pose that nothing observes must not make the system singular.
            S[offset[row] + row] += damping * U[f, i, i] + (1e-12 if U[f, i, i] > 1e-9 else 1.0)
    inverse, Y = np.empty((3, 3)), np.empty((6, 3))
    for q in range(len(V)):
        if first[q + 1] == first[q]:
            continue
        invert_point_block(V[q], damping, inverse)
        for m in range(first[q], first[q + 1]):
            f = column[kf[m]]
            if f < 0:
                continue
            for i in range(6):
                for j in range(3):
                    Y[i, j] = W[m, 0, i] * inverse[0, j] + W[m, 1, i] * inverse[1, j] + W[m, 2, i] * inverse[2, j]
                b[6 * f + i] -= Y[i, 0] * bv[q, 0] + Y[i, 1] * bv[q, 1] + Y[i, 2] * bv[q, 2]
            for n in range(first[q], first[q + 1]):
                g = column[kf[n]]
                if g < 0 or g > f:
                    continue
                for i in range(6):
                    o = offset[6 * f + i] + 6 * g
                    y0, y1, y2 = Y[i, 0], Y[i, 1], Y[i, 2]
                    for j in range(6):
                        S[o + j] -= y0 * W[n, 0, j] + y1 * W[n, 1, j] + y2 * W[n, 2, j]


@kernel(fastmath=FAST, forceinline=True)
def apply_step(
    poses: FloatArray,
    points: FloatArray,
    column: IntArray,
    kf: IntArray,
    first: IntArray,
    damping: float,
    V: FloatArray,
    W: FloatArray,
    bv: FloatArray,
    x: FloatArray,
    new_poses: FloatArray,
    new_points: FloatArray,
) -> None:
    """Write the updated poses and, by back-substitution, the updated points."""
    delta = np.zeros((4, 4))
    for k in range(len(poses)):
        if column[k] >= 0:
            exp_se3_into(x[6 * column[k] : 6 * column[k] + 6], delta)
            compose_into(delta, poses[k], new_poses[k])
            orthonormalise(new_poses[k])
    inverse, s = np.empty((3, 3)), np.empty(3)
    for q in range(len(points)):
        if first[q + 1] == first[q]:
            continue
        invert_point_block(V[q], damping, inverse)
        for j in range(3):
            s[j] = bv[q, j]
        for m in range(first[q], first[q + 1]):
            f = column[kf[m]]
            if f >= 0:
                for i in range(6):
                    for j in range(3):
                        s[j] -= W[m, j, i] * x[6 * f + i]
        for i in range(3):
            new_points[q, i] = points[q, i] + inverse[i, 0] * s[0] + inverse[i, 1] * s[1] + inverse[i, 2] * s[2]


@kernel()
def _copy(source: FloatArray, target: FloatArray) -> None:
    """Copy element by element: numba compiles seconds of error messages into a slice assignment."""
    for i in range(len(source)):
        target[i] = source[i]


@kernel()
def minimise(
    poses: FloatArray,
    points: FloatArray,
    column: IntArray,
    free: int,
    kf: IntArray,
    pt: IntArray,
    first: IntArray,
    uvr: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    active: BoolArray,
    robust: bool,
    iterations: int,
    tolerance: float,
) -> float:
    """Run Levenberg-Marquardt on ``poses`` and ``points`` in place and return the cost.

    Each iteration linearises once and tries up to eight dampings. It stops early when the cost changes by less than
    ``tolerance`` of itself. Only steps that lower a finite cost are taken, so no NaN gets in.
    """
    offset, start = np.zeros(6 * free, np.int64), np.zeros(6 * free, np.int64)
    S, b = np.empty(envelope(column, free, kf, first, offset, start)), np.empty(6 * free)
    U, V, W = np.empty((free, 6, 6)), np.empty((len(points), 3, 3)), np.empty((len(kf), 3, 6))
    bu, bv = np.empty((free, 6)), np.empty((len(points), 3))
    new_poses, new_points = poses.copy(), points.copy()
    damping = 1e-5
    cost = total_cost(poses, points, kf, pt, uvr, weight, camera, active, robust)
    for _ in range(iterations):
        normal_equations(poses, points, column, kf, pt, uvr, weight, camera, active, robust, U, V, W, bu, bv)
        before = cost
        for _ in range(8):
            reduce_to_poses(column, kf, first, damping, U, V, W, bu, bv, offset, S, b)
            if solve_envelope(S, offset, start, b):
                apply_step(poses, points, column, kf, first, damping, V, W, bv, b, new_poses, new_points)
                reached = total_cost(new_poses, new_points, kf, pt, uvr, weight, camera, active, robust)
                if reached < cost:
                    cost = reached
                    _copy(new_poses.reshape(-1), poses.reshape(-1))
                    _copy(new_points.reshape(-1), points.reshape(-1))
                    damping = max(damping * 0.1, 1e-10)
                    break
                if reached - cost <= tolerance * cost:
                    break
            damping *= 10.0
        if not before - cost > tolerance * before + 1e-12:
            break
    return cost
