"""All motions that the matches of two views allow: whether a first reconstruction is the only one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.kernels import kernel

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Square of the error in pixels that counts as half an outlier.
_LIMIT = 3.84
# Directions of half a sphere from which the search starts, about 25 degrees apart; errors do not know their sign.
_STARTS = 24
_ITERATIONS = 30
# The rotation alone follows the direction that was set for so many of them.
_ROTATION_FIRST = 4
_TOLERANCE = 1e-5


@dataclass(frozen=True)
class Motion:
    """A motion that no small change makes better.

    Attributes:
        c2Tc1: (4, 4) camera 1 to camera 2; the translation has length 1.
        cost: Sum over the matches of ``e^2 / (1 + e^2 / 3.84)``, e the Sampson error in pixels.
        in_front: Share of the matches with small errors whose points lie in front of both cameras.
    """

    c2Tc1: FloatArray
    cost: float
    in_front: float

    def direction_from(self, other: Motion) -> float:
        """Return the angle in radians between the directions of both translations."""
        return math.acos(float(np.clip(self.c2Tc1[:3, 3] @ other.c2Tc1[:3, 3], -1.0, 1.0)))


def search_motions(c2Tc1: FloatArray, rays1: FloatArray, rays2: FloatArray, focal: tuple[float, float]) -> list[Motion]:
    """Descend to the nearest minimum from a known motion, and from the same rotation with every direction.

    With little parallax a rotation looks almost like a translation to the side, and a shallow scene seen from far away
    like its mirror image: the error has several minima, and noise, rolling shutter or a focal length that is off by two
    per cent decide which one is lowest.

    Args:
        c2Tc1: (4, 4) a motion that explains the matches; the translation has length 1.
        rays1: (N, 2) normalised image coordinates in the first view.
        rays2: (N, 2) their matches in the second, N >= 1.
        focal: Focal lengths in pixels, for the errors.

    Returns:
        The minimum next to ``c2Tc1``, then those of the other starts, which may repeat each other.
    """
    rotation = np.ascontiguousarray(c2Tc1[:3, :3])
    found = []
    for t in (np.ascontiguousarray(c2Tc1[:3, 3]), *_directions()):
        motion = np.eye(4)
        cost = descend(rotation, t, rays1, rays2, focal[0], focal[1], motion)
        front, behind = _shares(motion, rays1, rays2, focal)
        if behind > front:
            motion[:3, 3] *= -1.0
        found.append(Motion(motion, cost, max(front, behind)))
    return found


def _directions() -> FloatArray:
    """Return (24, 3) unit vectors spread over half a sphere (a Fibonacci spiral)."""
    i = np.arange(_STARTS)
    z = (i + 0.5) / _STARTS
    turn, across = i * math.pi * (3.0 - math.sqrt(5.0)), np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _shares(c2Tc1: FloatArray, rays1: FloatArray, rays2: FloatArray, focal: tuple[float, float]) -> tuple[float, float]:
    """Return which shares of the points lie in front of both cameras and behind both."""
    R, t = c2Tc1[:3, :3], c2Tc1[:3, 3]
    r1, r2 = (np.column_stack([rays, np.ones(len(rays))]) for rays in (rays1, rays2))
    p, line = r1 @ R.T, np.cross(t, r1 @ R.T)
    back = np.cross(r2, t) @ R
    with np.errstate(divide="ignore", invalid="ignore"):
        square = (line[:, :2] ** 2 + back[:, :2] ** 2) @ (1.0 / np.square(focal))
        small = (line * r2).sum(axis=1) ** 2 < _LIMIT * square
    # depth2 * r2 = depth1 * p + t, so both depths up to a positive factor, from cross products with r2 and p.
    across = np.cross(p, r2)
    depth1 = -(across * np.cross(t, r2)).sum(axis=1)[small]
    depth2 = -(across * np.cross(t, p)).sum(axis=1)[small]
    if len(depth1) == 0:
        return 0.0, 0.0
    return float(np.mean((depth1 > 0) & (depth2 > 0))), float(np.mean((depth1 < 0) & (depth2 < 0)))


@kernel()
def descend(
    rotation: FloatArray,
    direction: FloatArray,
    rays1: FloatArray,
    rays2: FloatArray,
    fx: float,
    fy: float,
    c2Tc1: FloatArray,
) -> float:
    """Levenberg-Marquardt over rotation and direction, the rotation alone at first.

    Args:
        rotation: (3, 3) start.
        direction: (3,) start, of length 1.
        rays1: (N, 2) normalised image coordinates.
        rays2: (N, 2) their matches.
        fx: Focal length in pixels.
        fy: Focal length in pixels.
        c2Tc1: (4, 4) gets the result.

    Returns:
        The cost there.
    """
    R, t = rotation, direction
    A, g, A_new, g_new = np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5)
    B = _across(t)
    cost = _linearise(R, t, B, rays1, rays2, fx, fy, A, g)
    damping = 1e-3
    for iteration in range(_ITERATIONS):
        n = 3 if iteration < _ROTATION_FIRST else 5
        M = A[:n, :n].copy()
        for i in range(n):
            M[i, i] += damping * M[i, i] + 1e-9
        step = np.zeros(5)
        step[:n] = -np.linalg.solve(M, g[:n])
        R_new = _turned(R, step[0], step[1], step[2])
        t_new = t + B[:, 0] * step[3] + B[:, 1] * step[4]
        t_new /= math.sqrt(t_new[0] ** 2 + t_new[1] ** 2 + t_new[2] ** 2)
        B_new = _across(t_new)
        cost_new = _linearise(R_new, t_new, B_new, rays1, rays2, fx, fy, A_new, g_new)
        if cost_new < cost:
            converged = n == 5 and cost - cost_new < _TOLERANCE * cost
            R, t, B, cost = R_new, t_new, B_new, cost_new
            A[:], g[:] = A_new, g_new
            damping = max(0.2 * damping, 1e-6)
            if converged:
                break
        else:
            damping *= 8.0
            if damping > 1e6:
                break
    c2Tc1[:3, :3] = R
    c2Tc1[:3, 3] = t
    return cost


@kernel()
def _turned(R: FloatArray, w0: float, w1: float, w2: float) -> FloatArray:
    """Return exp(w) R by Rodrigues' formula."""
    angle = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    a = 1.0 if angle < 1e-9 else math.sin(angle) / angle
    b = 0.5 if angle < 1e-9 else (1.0 - math.cos(angle)) / (angle * angle)
    W = np.array([[0.0, -w2, w1], [w2, 0.0, -w0], [-w1, w0, 0.0]])
    return (np.eye(3) + a * W + b * (W @ W)) @ R


@kernel()
def _across(t: FloatArray) -> FloatArray:
    """Return two directions across ``t``, (3, 2)."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(t))] = 1.0
    B = np.empty((3, 2))
    u = np.cross(t, axis)
    B[:, 0] = u / math.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
    B[:, 1] = np.cross(t, B[:, 0])
    return B


@kernel()
def _linearise(
    R: FloatArray,
    t: FloatArray,
    B: FloatArray,
    rays1: FloatArray,
    rays2: FloatArray,
    fx: float,
    fy: float,
    A: FloatArray,
    g: FloatArray,
) -> float:
    """Fill the normal equations of the Sampson errors with Geman-McClure weights; return their cost."""
    A[:], g[:] = 0.0, 0.0
    cost = 0.0
    J = np.empty(5)
    t0, t1, t2 = t[0], t[1], t[2]
    for k in range(len(rays1)):
        x1, y1, x2, y2 = rays1[k, 0], rays1[k, 1], rays2[k, 0], rays2[k, 1]
        p0 = R[0, 0] * x1 + R[0, 1] * y1 + R[0, 2]
        p1 = R[1, 0] * x1 + R[1, 1] * y1 + R[1, 2]
        p2 = R[2, 0] * x1 + R[2, 1] * y1 + R[2, 2]
        # The epipolar lines t x p in image 2 and R' (r2 x t) in image 1.
        l0, l1, l2 = t1 * p2 - t2 * p1, t2 * p0 - t0 * p2, t0 * p1 - t1 * p0
        m0, m1, m2 = y2 * t2 - t1, t0 - x2 * t2, x2 * t1 - y2 * t0
        n0 = R[0, 0] * m0 + R[1, 0] * m1 + R[2, 0] * m2
        n1 = R[0, 1] * m0 + R[1, 1] * m1 + R[2, 1] * m2
        square = (l0 * l0 + n0 * n0) / (fx * fx) + (l1 * l1 + n1 * n1) / (fy * fy)
        if not square > 1e-30:
            cost += _LIMIT
            continue
        scale = 1.0 / math.sqrt(square)
        error = (l0 * x2 + l1 * y2 + l2) * scale
        whole = 1.0 + error * error / _LIMIT
        cost += error * error / whole
        weight = 1.0 / (whole * whole)
        # The error is t . (p x r2), so it changes by dt . (p x r2) and by w . (p x m) with a rotation w.
        J[0] = (p1 * m2 - p2 * m1) * scale
        J[1] = (p2 * m0 - p0 * m2) * scale
        J[2] = (p0 * m1 - p1 * m0) * scale
        c0, c1, c2 = p1 - p2 * y2, p2 * x2 - p0, p0 * y2 - p1 * x2
        J[3] = (B[0, 0] * c0 + B[1, 0] * c1 + B[2, 0] * c2) * scale
        J[4] = (B[0, 1] * c0 + B[1, 1] * c1 + B[2, 1] * c2) * scale
        for i in range(5):
            g[i] += weight * J[i] * error
            for j in range(i + 1):
                A[i, j] += weight * J[i] * J[j]
    for i in range(5):
        for j in range(i):
            A[j, i] = A[i, j]
    return cost
