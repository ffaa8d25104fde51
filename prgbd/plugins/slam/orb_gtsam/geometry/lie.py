"""Rotations and rigid transforms, exponential and logarithm, compiled by numba.

A twist is ``(omega, v)``: rotation first, as in GTSAM. Poses are updated from the left, ``exp(xi) @ cTw``, so a point
in camera coordinates moves by ``omega x p + v``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.kernels import kernel

FloatArray = NDArray[np.float64]

# Below this angle (radians) the series are exact to double precision.
_SMALL = 1e-5


@kernel()
def exp_se3_into(xi: FloatArray, out: FloatArray) -> None:
    """Write the transform of the twist ``xi`` (6,) into ``out`` (>= 3, 4); a last row, if any, is left alone."""
    x, y, z = xi[0], xi[1], xi[2]
    t2 = x * x + y * y + z * z
    theta = math.sqrt(t2)
    if theta < _SMALL:
        a, b, c = 1.0 - t2 / 6.0, 0.5 - t2 / 24.0, 1.0 / 6.0 - t2 / 120.0
    else:
        a = math.sin(theta) / theta
        half = math.sin(0.5 * theta)
        b = 2.0 * half * half / t2
        c = (1.0 - a) / t2
    # R = I + a [w]x + b [w]x^2 and V = I + b [w]x + c [w]x^2, with [w]x^2 = w w' - |w|^2 I.
    out[0, 0], out[0, 1], out[0, 2] = 1.0 + b * (x * x - t2), b * x * y - a * z, b * x * z + a * y
    out[1, 0], out[1, 1], out[1, 2] = b * x * y + a * z, 1.0 + b * (y * y - t2), b * y * z - a * x
    out[2, 0], out[2, 1], out[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 + b * (z * z - t2)
    vx, vy, vz = xi[3], xi[4], xi[5]
    along = c * (x * vx + y * vy + z * vz)
    keep = 1.0 - c * t2
    out[0, 3] = keep * vx + b * (y * vz - z * vy) + along * x
    out[1, 3] = keep * vy + b * (z * vx - x * vz) + along * y
    out[2, 3] = keep * vz + b * (x * vy - y * vx) + along * z


@kernel()
def compose_into(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write ``a @ b`` of two rigid transforms (>= 3, 4) into ``out``, which must be neither."""
    for i in range(3):
        for j in range(4):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
        out[i, 3] += a[i, 3]


@kernel()
def orthonormalise(pose: FloatArray) -> None:
    """Restore a rotation that drifted by rounding, in place, by Gram-Schmidt on its rows."""
    n = math.sqrt(pose[0, 0] ** 2 + pose[0, 1] ** 2 + pose[0, 2] ** 2)
    for j in range(3):
        pose[0, j] /= n
    d = pose[0, 0] * pose[1, 0] + pose[0, 1] * pose[1, 1] + pose[0, 2] * pose[1, 2]
    for j in range(3):
        pose[1, j] -= d * pose[0, j]
    n = math.sqrt(pose[1, 0] ** 2 + pose[1, 1] ** 2 + pose[1, 2] ** 2)
    for j in range(3):
        pose[1, j] /= n
    pose[2, 0] = pose[0, 1] * pose[1, 2] - pose[0, 2] * pose[1, 1]
    pose[2, 1] = pose[0, 2] * pose[1, 0] - pose[0, 0] * pose[1, 2]
    pose[2, 2] = pose[0, 0] * pose[1, 1] - pose[0, 1] * pose[1, 0]


def exp_se3(xi: FloatArray) -> FloatArray:
    """Return the transform (4, 4) of a twist ``(omega, v)`` (6,): radians and metres."""
    out = np.eye(4)
    exp_se3_into(np.ascontiguousarray(xi, np.float64), out)
    return out


def exp_so3(omega: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) of a rotation vector (3,) in radians."""
    xi = np.zeros(6)
    xi[:3] = omega
    return exp_se3(xi)[:3, :3].copy()


def log_so3(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector (3,) of a rotation (3, 3), of length at most pi, stable near 0 and near pi."""
    r = np.asarray(rotation, np.float64)[:3, :3]
    # Shepperd's method: divide by the largest of the four quaternion components.
    q = np.array([1 + np.trace(r), *(1 + 2 * np.diag(r) - np.trace(r))])
    k = int(np.argmax(q))
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    if k == 0:
        w, v = q[0], skew
    else:
        i = k - 1
        w, v = skew[i], r[:, i] + r[i, :]
        v[i] = q[k]
    if w < 0:
        w, v = -w, -v
    n = float(np.linalg.norm(v))
    return v * (2.0 / w) if n < 1e-12 else v * (2.0 * math.atan2(n, w) / n)


def log_se3(pose: FloatArray) -> FloatArray:
    """Return the twist ``(omega, v)`` (6,) of a rigid transform (4, 4)."""
    omega = log_so3(pose[:3, :3])
    theta = float(np.linalg.norm(omega))
    x, y, z = omega
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    c = 1.0 / 12.0 if theta < 1e-4 else (1.0 - 0.5 * theta / math.tan(0.5 * theta)) / theta**2
    return np.concatenate([omega, (np.eye(3) - 0.5 * k + c * (k @ k)) @ pose[:3, 3]])


def inverse(pose: FloatArray) -> FloatArray:
    """Return the inverse of rigid transforms (..., 4, 4)."""
    out = np.zeros_like(pose)
    rt = np.swapaxes(pose[..., :3, :3], -1, -2)
    out[..., :3, :3] = rt
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", rt, pose[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out
