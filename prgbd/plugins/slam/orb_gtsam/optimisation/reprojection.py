"""One observation of one point: its error, its weight and its derivatives, monocular or stereo."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.chi_square import CHI2_MONO, CHI2_STEREO
from prgbd.plugins.slam.orb_gtsam.kernels import FAST, kernel

FloatArray = NDArray[np.float64]

# Chi-square that a point behind the camera counts for: constant, so steps that push points back there lose.
_BEHIND = 1e6


def split_weights(inv_sigma2: FloatArray) -> FloatArray:
    """Bring inverse variances into the form that the compiled functions take.

    The relative accuracy scales the error of ``u_right`` to the noise of ``(u, v)``. It is exactly 1 where both are
    equally accurate, which makes the result the same, bit for bit, as with a single variance.

    Args:
        inv_sigma2: (M,) inverse variance of ``(u, v, u_right)``, or (M, 2) of ``(u, v)`` and of ``u_right``; 1 / px^2.

    Returns:
        (M, 2) inverse variance of ``(u, v)``, and standard deviation of ``(u, v)`` over that of ``u_right``.
    """
    given = np.asarray(inv_sigma2, np.float64)
    split = np.ones((len(given), 2))
    if given.ndim == 1:
        split[:, 0] = given
        return split
    split[:, 0] = given[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        split[:, 1] = np.sqrt(given[:, 1] / given[:, 0])
    return split


@kernel(forceinline=True)
def keep_monocular(pose: FloatArray, p: FloatArray, obs: FloatArray, weight: FloatArray, camera: FloatArray) -> bool:
    """Take the measured depth from an observation that only its depth makes an outlier; return whether it was.

    ``obs`` (3,) gets ``u_right`` -1 where the three together exceed the 95 % limit but ``(u, v)`` alone does not.
    """
    if obs[2] < 0.0 or chi2_of(pose, p, obs, weight, camera) <= CHI2_STEREO:
        return False
    right, obs[2] = obs[2], -1.0
    if chi2_of(pose, p, obs, weight, camera) <= CHI2_MONO:
        return True
    obs[2] = right
    return False


@kernel(fastmath=FAST, forceinline=True)
def chi2_of(pose: FloatArray, p: FloatArray, obs: FloatArray, weight: FloatArray, camera: FloatArray) -> float:
    """Return the chi-square of one observation ``(u, v, u_right or -1)``; infinite behind the camera.

    ``weight`` is one row of ``split_weights``.
    """
    z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
    if not z > 1e-9:
        return math.inf
    iz = 1.0 / z
    x = pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]
    y = pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]
    u = camera[0] * x * iz + camera[2]
    eu, ev = obs[0] - u, obs[1] - (camera[1] * y * iz + camera[3])
    square = eu * eu + ev * ev
    if obs[2] >= 0.0:
        er = (obs[2] - (u - camera[4] * iz)) * weight[1]
        square += er * er
    return square * weight[0]


@kernel(fastmath=FAST, forceinline=True)
def penalty(chi2: float, stereo: bool, robust: bool) -> float:
    """Return what a chi-square adds to the cost: itself, or Huber's rho of it, finite even behind the camera."""
    chi2 = chi2 if chi2 < math.inf else _BEHIND
    limit = CHI2_STEREO if stereo else CHI2_MONO
    return chi2 if chi2 <= limit or not robust else 2.0 * math.sqrt(limit * chi2) - limit


@kernel(fastmath=FAST, forceinline=True)
def linearise(
    pose: FloatArray,
    p: FloatArray,
    obs: FloatArray,
    weight: FloatArray,
    camera: FloatArray,
    robust: bool,
    G: FloatArray,
    e: FloatArray,
) -> float:
    """Fill the derivatives of one prediction and its error; return the weight it enters the equations with.

    Args:
        pose: World to camera (4, 4).
        p: Point in the world (3,).
        obs: ``(u, v, u_right or -1)``.
        weight: Inverse variance of ``(u, v)`` and relative accuracy of ``u_right``, a row of ``split_weights``.
        camera: ``(fx, fy, cx, cy, bf)``.
        robust: Whether to apply the Huber weight.
        G: Receives (3, 6), the derivative by the left twist ``(omega, v)`` of the pose; its last three columns are
            the derivative by the point in camera coordinates. The last row is zero for a monocular observation.
        e: Receives (3,), observation minus prediction. Last row and last error are scaled by ``u_right``'s relative
            accuracy, so that one weight serves all three.

    Returns:
        The weight, or 0 behind the camera.
    """
    z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
    if not z > 1e-9:
        return 0.0
    fx, fy = camera[0], camera[1]
    iz = 1.0 / z
    a = (pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]) * iz
    c = (pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]) * iz
    e[0] = obs[0] - (fx * a + camera[2])
    e[1] = obs[1] - (fy * c + camera[3])
    # The point moves by omega x p + v.
    G[0, 0], G[0, 1], G[0, 2] = -fx * a * c, fx * (1.0 + a * a), -fx * c
    G[0, 3], G[0, 4], G[0, 5] = fx * iz, 0.0, -fx * a * iz
    G[1, 0], G[1, 1], G[1, 2] = -fy * (1.0 + c * c), fy * a * c, fy * a
    G[1, 3], G[1, 4], G[1, 5] = 0.0, fy * iz, -fy * c * iz
    if obs[2] >= 0.0:
        # u_right = u - bf / z adds bf / z^2 dz, with dz = omega_x y - omega_y x + v_z.
        limit = CHI2_STEREO
        d = camera[4] * iz
        s = weight[1]
        e[2] = s * (obs[2] - (fx * a + camera[2] - d))
        G[2, 0], G[2, 1], G[2, 2] = s * (G[0, 0] + d * c), s * (G[0, 1] - d * a), s * G[0, 2]
        G[2, 3], G[2, 4], G[2, 5] = s * G[0, 3], 0.0, s * (G[0, 5] + d * iz)
    else:
        limit = CHI2_MONO
        e[2] = 0.0
        for j in range(6):
            G[2, j] = 0.0
    chi2 = (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]) * weight[0]
    return weight[0] * math.sqrt(limit / chi2) if robust and chi2 > limit else weight[0]
