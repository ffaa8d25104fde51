"""Similarity transforms: closed form, RANSAC and refinement by reprojection in two keyframes.

A similarity is a (4, 4) matrix ``[[s R, t], [0, 1]]``; ``aSb`` takes points of camera b, in units of b, to camera a.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_so3

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# ORB-SLAM2 (Sim3Solver): 99 % limit of two degrees of freedom, probability of success, most hypotheses.
CHI2_RANSAC = 9.210
_PROBABILITY, _HYPOTHESES = 0.99, 300
# ORB-SLAM2 (Optimizer::OptimizeSim3): Huber's limit and that of outliers (chi-square), iterations before and after.
_CHI2_REFINED = 10.0
_ROUNDS = (5, 10)
# Standard deviation of the log of a depth ratio. Two cameras in the same place see the same at any scale, so that
# reprojection alone, as in ORB-SLAM2, would leave the scale of the commonest loop open.
_LOG_DEPTH_SIGMA = 0.1


@dataclass(frozen=True)
class Correspondences:
    """Points that two keyframes see, each in its own camera coordinates and units.

    Attributes:
        xyz_a: (N, 3) in camera a.
        xyz_b: (N, 3) in camera b.
        uv_a: (N, 2) pixels in image a.
        uv_b: (N, 2) pixels in image b.
        weight_a: (N,) inverse variance of ``uv_a``, 1 / px^2.
        weight_b: (N,) inverse variance of ``uv_b``.
        intrinsics: ``fx, fy, cx, cy``.
    """

    xyz_a: FloatArray
    xyz_b: FloatArray
    uv_a: FloatArray
    uv_b: FloatArray
    weight_a: FloatArray
    weight_b: FloatArray
    intrinsics: tuple[float, float, float, float]

    def __len__(self) -> int:
        return len(self.xyz_a)

    def chi2(self, aSb: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the squared errors in both images in units of their variance, infinite behind a camera.

        Args:
            aSb: (..., 4, 4) similarities.

        Returns:
            Two arrays (..., N): in image a and in image b.
        """
        bSa = invert(aSb)
        in_a = np.einsum("...ij,nj->...ni", aSb[..., :3, :3], self.xyz_b) + aSb[..., None, :3, 3]
        in_b = np.einsum("...ij,nj->...ni", bSa[..., :3, :3], self.xyz_a) + bSa[..., None, :3, 3]
        return self._chi2(in_a, self.uv_a, self.weight_a), self._chi2(in_b, self.uv_b, self.weight_b)

    def _chi2(self, xyz: FloatArray, uv: FloatArray, weight: FloatArray) -> FloatArray:
        fx, fy, cx, cy = self.intrinsics
        front = xyz[..., 2] > 1e-9
        z = np.where(front, xyz[..., 2], 1.0)
        u, v = fx * xyz[..., 0] / z + cx - uv[:, 0], fy * xyz[..., 1] / z + cy - uv[:, 1]
        return np.where(front, (u * u + v * v) * weight, np.inf)


def similarity(rotation: FloatArray, translation: FloatArray, scale: float) -> FloatArray:
    """Return the (4, 4) matrix of ``p -> scale * rotation @ p + translation``."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = scale * rotation, translation
    return out


def scale_of(S: FloatArray) -> float:
    """Return the scale of a similarity."""
    return float(np.cbrt(np.linalg.det(S[:3, :3])))


def invert(S: FloatArray) -> FloatArray:
    """Return the inverse of similarities (..., 4, 4)."""
    out = np.zeros_like(S)
    transposed = np.swapaxes(S[..., :3, :3], -1, -2)
    # (s R)^-1 = (s R)' / s^2, and the squares of a row of s R sum to s^2.
    out[..., :3, :3] = transposed / np.sum(S[..., :1, :3] ** 2, axis=-1, keepdims=True)
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", out[..., :3, :3], S[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def align(a: FloatArray, b: FloatArray, *, free_scale: bool) -> FloatArray:
    """Find the similarities that bring points b closest to points a.

    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.

    Args:
        a: (..., N, 3) points, N >= 3.
        b: (..., N, 3) points.
        free_scale: Whether to estimate scale; it is 1 otherwise.

    Returns:
        (..., 4, 4) ``aSb``. Points on a line leave the rotation about it open; it is still a rotation.
    """
    mean_a, mean_b = a.mean(axis=-2, keepdims=True), b.mean(axis=-2, keepdims=True)
    from_a, from_b = a - mean_a, b - mean_b
    U, D, Vt = np.linalg.svd(np.swapaxes(from_a, -1, -2) @ from_b)
    sign = np.ones_like(D)
    sign[..., 2] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = (U * sign[..., None, :]) @ Vt
    scale = np.ones(D.shape[:-1])
    if free_scale:
        scale = np.sum(D * sign, axis=-1) / np.maximum(np.sum(from_b**2, axis=(-2, -1)), 1e-300)
        scale = np.where((scale > 1e-9) & (scale < 1e9), scale, 1.0)
    out = np.zeros((*scale.shape, 4, 4))
    out[..., :3, :3] = scale[..., None, None] * R
    out[..., :3, 3] = mean_a[..., 0, :] - np.einsum("...ij,...j->...i", out[..., :3, :3], mean_b[..., 0, :])
    out[..., 3, 3] = 1.0
    return out


def ransac(
    pairs: Correspondences, rng: np.random.Generator, *, free_scale: bool, least: int
) -> tuple[FloatArray, BoolArray] | None:
    """Find a similarity that at least ``least`` correspondences agree with, as ORB-SLAM2's ``Sim3Solver``.

    Args:
        pairs: The correspondences, right and wrong ones.
        rng: Draws the triples.
        free_scale: Whether scale is estimated.
        least: Fewest inliers.

    Returns:
        ``aSb`` (4, 4), fitted to its inliers, and which correspondences are inliers, or None.
    """
    n = len(pairs)
    if n < max(least, 3):
        return None
    share = least / n
    wanted = _HYPOTHESES
    if share < 1.0:
        wanted = min(wanted, int(np.ceil(np.log(1.0 - _PROBABILITY) / np.log(1.0 - share**3))))
    triples = np.argsort(rng.random((max(wanted, 1), n)), axis=1)[:, :3]
    hypotheses = align(pairs.xyz_a[triples], pairs.xyz_b[triples], free_scale=free_scale)
    inlier = _agree(pairs, hypotheses, CHI2_RANSAC)
    best = int(np.argmax(inlier.sum(axis=1)))
    chosen, aSb = inlier[best], hypotheses[best]
    if chosen.sum() < least:
        return None
    fitted = align(pairs.xyz_a[chosen], pairs.xyz_b[chosen], free_scale=free_scale)
    again = _agree(pairs, fitted, CHI2_RANSAC)
    return (fitted, again) if again.sum() >= chosen.sum() else (aSb, chosen)


def refine(
    pairs: Correspondences, aSb: FloatArray, inlier: BoolArray, *, free_scale: bool
) -> tuple[FloatArray, BoolArray]:
    """Minimise the reprojection errors in both images, as ORB-SLAM2's ``OptimizeSim3``, and those of depth ratios.

    Levenberg-Marquardt with a Huber kernel; outliers are dropped after the first round.

    Args:
        pairs: The correspondences.
        aSb: (4, 4) first guess.
        inlier: (N,) bool, the correspondences to begin with.
        free_scale: Whether scale may change.

    Returns:
        The similarity (4, 4), and which correspondences agree with it in both images.
    """
    active = inlier.copy()
    for iterations in _ROUNDS:
        if active.sum() < 3:
            break
        aSb = _minimise(pairs, aSb, active, free_scale, iterations)
        active &= _agree(pairs, aSb, _CHI2_REFINED)
    return aSb, _agree(pairs, aSb, _CHI2_REFINED)


def _agree(pairs: Correspondences, aSb: FloatArray, limit: float) -> BoolArray:
    chi2_a, chi2_b = pairs.chi2(aSb)
    return np.asarray((chi2_a <= limit) & (chi2_b <= limit))


def _cost(pairs: Correspondences, aSb: FloatArray, active: BoolArray) -> float:
    chi2_a, chi2_b = pairs.chi2(aSb)
    chi2_depth = (_log_depth_ratio(pairs, aSb, active)[0] / _LOG_DEPTH_SIGMA) ** 2
    total = 0.0
    for chi2 in (chi2_a[active], chi2_b[active], chi2_depth):
        chi2 = np.minimum(chi2, 1e12)
        huber = np.where(chi2 <= _CHI2_REFINED, chi2, 2.0 * np.sqrt(_CHI2_REFINED * chi2) - _CHI2_REFINED)
        total += float(huber.sum())
    return total


def _log_depth_ratio(pairs: Correspondences, aSb: FloatArray, active: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the log of measured by predicted depth in camera a (0 behind it), and the predicted depth."""
    predicted = pairs.xyz_b[active] @ aSb[2, :3] + aSb[2, 3]
    measured = pairs.xyz_a[active, 2]
    front = (predicted > 1e-9) & (measured > 1e-9)
    return np.where(front, np.log(np.where(front, measured / np.where(front, predicted, 1.0), 1.0)), 0.0), predicted


def _huber_weight(chi2: FloatArray) -> FloatArray:
    return np.where(chi2 > _CHI2_REFINED, np.sqrt(_CHI2_REFINED / np.maximum(chi2, 1e-300)), 1.0)


def _minimise(
    pairs: Correspondences, aSb: FloatArray, active: BoolArray, free_scale: bool, iterations: int
) -> FloatArray:
    size = 7 if free_scale else 6
    damping, cost = 1e-4, _cost(pairs, aSb, active)
    for _ in range(iterations):
        H, g = _normal_equations(pairs, aSb, active)
        H, g = H[:size, :size], g[:size]
        for _ in range(8):
            step = np.zeros(7)
            step[:size] = np.linalg.solve(H + damping * np.diag(np.diag(H)) + 1e-12 * np.eye(size), g)
            trial = similarity(exp_so3(step[:3]), step[3:6], float(np.exp(step[6]))) @ aSb
            reached = _cost(pairs, trial, active)
            if reached < cost:
                break
            damping *= 10.0
        if not reached < cost:
            break
        done = cost - reached < 1e-6 * cost
        aSb, cost, damping = trial, reached, damping * 0.1
        if done:
            break
    return aSb


def _normal_equations(pairs: Correspondences, aSb: FloatArray, active: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return ``H, g`` of ``H xi = g`` for the left update by ``xi = (omega, v, log of scale)``."""
    bSa = invert(aSb)
    here = pairs.xyz_b[active] @ aSb[:3, :3].T + aSb[:3, 3]
    there = pairs.xyz_a[active]
    H, g = np.zeros((7, 7)), np.zeros(7)
    # In image a the point moves by the update, in image b by its inverse.
    for moved, rotation, uv, weight, sign in (
        (here, np.eye(3), pairs.uv_a, pairs.weight_a, 1.0),
        (there, bSa[:3, :3], pairs.uv_b, pairs.weight_b, -1.0),
    ):
        motion = np.zeros((len(moved), 3, 7))
        x, y, z = moved.T
        motion[:, 0, 1], motion[:, 0, 2] = z, -y
        motion[:, 1, 0], motion[:, 1, 2] = -z, x
        motion[:, 2, 0], motion[:, 2, 1] = y, -x
        motion[:, 0, 3] = motion[:, 1, 4] = motion[:, 2, 5] = 1.0
        motion[:, :, 6] = moved
        seen = moved if sign > 0 else there @ bSa[:3, :3].T + bSa[:3, 3]
        derivative, error = _image_derivative(pairs, seen, uv[active])
        J = derivative @ (sign * rotation @ motion)
        chi2 = (error**2).sum(axis=1) * weight[active]
        w = np.where(seen[:, 2] > 1e-9, weight[active] * _huber_weight(chi2), 0.0)
        if sign > 0:
            ratio, depth = _log_depth_ratio(pairs, aSb, active)
            J_depth = motion[:, 2] / np.where(depth > 1e-9, depth, np.inf)[:, None]
            w_depth = _huber_weight((ratio / _LOG_DEPTH_SIGMA) ** 2) / _LOG_DEPTH_SIGMA**2
            H += np.einsum("n,ni,nj->ij", w_depth, J_depth, J_depth)
            g += np.einsum("n,ni,n->i", w_depth, J_depth, ratio)
        H += np.einsum("n,nki,nkj->ij", w, J, J)
        g += np.einsum("n,nki,nk->i", w, J, error)
    return H, g


def _image_derivative(pairs: Correspondences, xyz: FloatArray, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the derivative (N, 2, 3) of pixels by camera coordinates, and the errors (N, 2)."""
    fx, fy, cx, cy = pairs.intrinsics
    iz = 1.0 / np.where(xyz[:, 2] > 1e-9, xyz[:, 2], 1.0)
    a, b = xyz[:, 0] * iz, xyz[:, 1] * iz
    out = np.zeros((len(xyz), 2, 3))
    out[:, 0, 0], out[:, 0, 2] = fx * iz, -fx * a * iz
    out[:, 1, 1], out[:, 1, 2] = fy * iz, -fy * b * iz
    return out, uv - np.stack([fx * a + cx, fy * b + cy], axis=1)
