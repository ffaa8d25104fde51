"""The compiled core of bundle adjustment: normal equations, Schur complement and a sparse Cholesky solver.

Points are eliminated, and the remaining system of poses is kept by rows from their first nonzero block on (an
envelope), so it stays small for cameras in temporal order however long the trajectory.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.lie import compose_into, exp_se3_into, orthonormalise
from prgbd.plugins.slam.orb_gtsam.pose_optimisation import CHI2_MONO, CHI2_STEREO, chi2_of, penalty

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Sums may be reordered, but NaN must stay visible.
_FAST = {"contract", "reassoc", "nsz"}


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def linearise_one(
    pose: FloatArray,
    p: FloatArray,
    obs: FloatArray,
    weight: float,
    camera: FloatArray,
    robust: bool,
    A: FloatArray,
    G: FloatArray,
    e: FloatArray,
) -> float:
    """Fill the derivatives of one prediction and its error; return the weight it enters the equations with.

    Args:
        pose: World to camera (4, 4).
        p: Point in the world (3,).
        obs: ``(u, v, u_right or -1)``.
        weight: Inverse variance.
        camera: ``(fx, fy, cx, cy, bf)``.
        robust: Whether to apply the Huber weight.
        A: Receives (3, 3), the derivative by the point in the world; its last row is zero for monocular ones.
        G: Receives (3, 6), the derivative by the left twist ``(omega, v)`` of the pose.
        e: Receives (3,), observation minus prediction.

    Returns:
        The weight, or 0 behind the camera.
    """
    z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
    if not z > 1e-9:
        return 0.0
    fx, fy, bf = camera[0], camera[1], camera[4]
    iz = 1.0 / z
    a = (pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]) * iz
    c = (pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]) * iz
    # Derivatives by the point in camera coordinates: (fu, 0, gu), (0, fv, gv), (fu, 0, gr).
    fu, fv = fx * iz, fy * iz
    gu, gv = -fu * a, -fv * c
    e[0] = obs[0] - (fx * a + camera[2])
    e[1] = obs[1] - (fy * c + camera[3])
    chi2 = e[0] * e[0] + e[1] * e[1]
    # d(x, y, z) = omega x p + v.
    G[0, 0], G[0, 1], G[0, 2], G[0, 3], G[0, 4], G[0, 5] = -fx * a * c, fx * (1.0 + a * a), -fx * c, fu, 0.0, gu
    G[1, 0], G[1, 1], G[1, 2], G[1, 3], G[1, 4], G[1, 5] = -fy * (1.0 + c * c), fy * a * c, fy * a, 0.0, fv, gv
    for j in range(3):
        A[0, j] = fu * pose[0, j] + gu * pose[2, j]
        A[1, j] = fv * pose[1, j] + gv * pose[2, j]
    limit = CHI2_MONO
    if obs[2] >= 0.0:
        limit = CHI2_STEREO
        d = bf * iz * iz
        e[2] = obs[2] - (fx * a + camera[2] - bf * iz)
        chi2 += e[2] * e[2]
        for j in range(6):
            G[2, j] = G[0, j]
        G[2, 0] += d * c * z
        G[2, 1] -= d * a * z
        G[2, 5] += d
        for j in range(3):
            A[2, j] = A[0, j] + d * pose[2, j]
    else:
        e[2] = 0.0
        G[2, :] = 0.0
        A[2, :] = 0.0
    chi2 *= weight
    return weight * math.sqrt(limit / chi2) if robust and chi2 > limit else weight


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
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
    """Fill the blocks of the normal equations: ``U`` (F, 6, 6), ``V`` (P, 3, 3), ``W`` (M, 6, 3) and right sides.

    ``column`` (K,) is the number of a free pose among the free ones, or -1 for a fixed one.
    """
    U[:] = 0.0
    V[:] = 0.0
    bu[:] = 0.0
    bv[:] = 0.0
    A, G, e = np.empty((3, 3)), np.empty((3, 6)), np.empty(3)
    for m in range(len(kf)):
        w = 0.0
        if active[m]:
            w = linearise_one(poses[kf[m]], points[pt[m]], uvr[m], weight[m], camera, robust, A, G, e)
        f, q = column[kf[m]], pt[m]
        if w == 0.0:
            W[m] = 0.0
            continue
        rows = 3 if uvr[m, 2] >= 0.0 else 2
        for i in range(3):
            for r in range(rows):
                s = w * A[r, i]
                bv[q, i] += s * e[r]
                for j in range(3):
                    V[q, i, j] += s * A[r, j]
        if f < 0:
            continue
        for i in range(6):
            w0, w1, w2 = w * G[0, i], w * G[1, i], w * G[2, i]
            bu[f, i] += w0 * e[0] + w1 * e[1] + w2 * e[2]
            for j in range(i + 1):
                U[f, i, j] += w0 * G[0, j] + w1 * G[1, j] + w2 * G[2, j]
            for j in range(3):
                W[m, i, j] = w0 * A[0, j] + w1 * A[1, j] + w2 * A[2, j]


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
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


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
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
                    Y[i, j] = W[m, i, 0] * inverse[0, j] + W[m, i, 1] * inverse[1, j] + W[m, i, 2] * inverse[2, j]
                b[6 * f + i] -= Y[i, 0] * bv[q, 0] + Y[i, 1] * bv[q, 1] + Y[i, 2] * bv[q, 2]
            for n in range(first[q], first[q + 1]):
                g = column[kf[n]]
                if g < 0 or g > f:
                    continue
                for i in range(6):
                    o = offset[6 * f + i] + 6 * g
                    for j in range(6):
                        S[o + j] -= Y[i, 0] * W[n, j, 0] + Y[i, 1] * W[n, j, 1] + Y[i, 2] * W[n, j, 2]


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def solve_envelope(S: FloatArray, offset: IntArray, start: IntArray, b: FloatArray) -> bool:
    """Solve ``S x = b`` in place (``b`` becomes ``x``) by Cholesky within the envelope; False if not positive definite.

    Row i has its first nonzero at column ``start[i]``; element (i, j) is ``S[offset[i] + j]``. ``S`` becomes L.
    """
    n = len(b)
    for i in range(n):
        oi = offset[i]
        for j in range(start[i], i + 1):
            oj = offset[j]
            s = S[oi + j]
            begin = max(start[i], start[j])
            row_i, row_j = S[oi + begin : oi + j], S[oj + begin : oj + j]
            for k in range(len(row_i)):
                s -= row_i[k] * row_j[k]
            if j < i:
                S[oi + j] = s / S[oj + j]
            elif s > 0.0:
                S[oi + i] = math.sqrt(s)
            else:
                return False
        s = b[i]
        for k in range(start[i], i):
            s -= S[oi + k] * b[k]
        b[i] = s / S[oi + i]
    for i in range(n - 1, -1, -1):
        b[i] /= S[offset[i] + i]
        for k in range(start[i], i):
            b[k] -= S[offset[i] + k] * b[i]
    return True


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
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
                        s[j] -= W[m, i, j] * x[6 * f + i]
        for i in range(3):
            new_points[q, i] = points[q, i] + inverse[i, 0] * s[0] + inverse[i, 1] * s[1] + inverse[i, 2] * s[2]


@numba.njit(cache=True, nogil=True)
def envelope(column: IntArray, free: int, kf: IntArray, first: IntArray, offset: IntArray, start: IntArray) -> int:
    """Fill ``offset`` and ``start`` (6 F,) of the reduced system and return how many numbers its envelope holds."""
    lowest = np.arange(free)
    for q in range(len(first) - 1):
        low = free
        for m in range(first[q], first[q + 1]):
            if column[kf[m]] >= 0:
                low = min(low, column[kf[m]])
        for m in range(first[q], first[q + 1]):
            f = column[kf[m]]
            if f >= 0:
                lowest[f] = min(lowest[f], low)
    size = 0
    for f in range(free):
        begin = 6 * lowest[f]
        for i in range(6 * f, 6 * f + 6):
            start[i] = begin
            offset[i] = size - begin
            size += 6 * f + 6 - begin
    return size


@numba.njit(cache=True, nogil=True)
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

    Each iteration linearises once and tries up to eight dampings. It stops early when the cost falls by less than
    ``tolerance`` of itself. Only steps that lower a finite cost are taken, so no NaN gets in.
    """
    offset, start = np.zeros(6 * free, np.int64), np.zeros(6 * free, np.int64)
    S, b = np.empty(envelope(column, free, kf, first, offset, start)), np.empty(6 * free)
    U, V, W = np.empty((free, 6, 6)), np.empty((len(points), 3, 3)), np.empty((len(kf), 6, 3))
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
                lower = total_cost(new_poses, new_points, kf, pt, uvr, weight, camera, active, robust)
                if lower < cost:
                    cost = lower
                    poses[:] = new_poses
                    points[:] = new_points
                    damping = max(damping * 0.1, 1e-10)
                    break
            damping *= 10.0
        if not before - cost > tolerance * before + 1e-12:
            break
    return cost
