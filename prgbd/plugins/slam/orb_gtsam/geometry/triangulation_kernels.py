"""Points from matched keypoints of two keyframes, and which of them to believe."""

from __future__ import annotations

import math

import numpy as np

from prgbd.plugins.slam.orb_gtsam.camera.chi_square import CHI2_MONO, CHI2_STEREO
from prgbd.plugins.slam.orb_gtsam.geometry.two_view import triangulate_into
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

# ORB-SLAM2 (LocalMapping::CreateNewMapPoints).
_MAX_PARALLAX_COSINE = 0.9998
_SCALE_TOLERANCE = 1.5
# The cosine of a pair without measured depth.
_NO_STEREO = 2.0


@kernel()
def _stereo_cosine(depth: float, u_right: float, sigma: float, baseline: float) -> float:
    """Cosine of the parallax that the (virtual) stereo pair gives; 2 without depth."""
    if depth > 0 and u_right >= 0:
        # Depth that errs by sigma pixels of disparity, where stereo errs by one, is worth a baseline that much shorter.
        return math.cos(2.0 * math.atan2(0.5 * baseline / math.sqrt(1.0 + sigma * sigma), depth))
    return _NO_STEREO


@kernel()
def _to_camera(cTw: np.ndarray, p: np.ndarray, out: np.ndarray) -> None:
    for i in range(3):
        out[i] = cTw[i, 0] * p[0] + cTw[i, 1] * p[1] + cTw[i, 2] * p[2] + cTw[i, 3]


@kernel()
def _to_world(cTw: np.ndarray, p: np.ndarray, out: np.ndarray) -> None:
    x, y, z = p[0] - cTw[0, 3], p[1] - cTw[1, 3], p[2] - cTw[2, 3]
    for j in range(3):
        out[j] = cTw[0, j] * x + cTw[1, j] * y + cTw[2, j] * z


@kernel()
def _agrees(
    p: np.ndarray, u: float, v: float, u_right: float, sigma: float, fallback: bool, scale: float, camera: np.ndarray
) -> bool:
    """Whether a point in camera coordinates lies in front and projects to a keypoint by the chi-square test.

    ``sigma`` is what the depth adds to the noise of ``u_right``; with ``fallback`` the pixel alone may pass.
    """
    if not p[2] > 1e-6:
        return False
    column = camera[0] * p[0] / p[2] + camera[2]
    eu, ev = column - u, camera[1] * p[1] / p[2] + camera[3] - v
    variance = scale * scale
    square, limit = eu * eu + ev * ev, CHI2_MONO
    if u_right >= 0 and not (fallback and square <= limit * variance):
        er = column - camera[4] / p[2] - u_right
        square, limit = square + er * er * (variance / (variance + sigma * sigma)), CHI2_STEREO
    return square <= limit * variance


@kernel()
def _parallax_cosine(c2Tc1: np.ndarray, ray1: np.ndarray, ray2: np.ndarray) -> float:
    """Cosine of the angle between two rays ``(x, y, 1)`` of two cameras."""
    dot, square = 0.0, 0.0
    for i in range(3):
        turned = c2Tc1[i, 0] * ray1[0] + c2Tc1[i, 1] * ray1[1] + c2Tc1[i, 2]
        dot += turned * (ray2[i] if i < 2 else 1.0)
        square += turned * turned
    return dot / math.sqrt(square * (ray2[0] * ray2[0] + ray2[1] * ray2[1] + 1.0))


@kernel()
def _lift(
    u: float, v: float, depth: float, cTw: np.ndarray, camera: np.ndarray, p: np.ndarray, out: np.ndarray
) -> None:
    p[0], p[1], p[2] = (u - camera[2]) / camera[0] * depth, (v - camera[3]) / camera[1] * depth, depth
    _to_world(cTw, p, out)


@kernel()
def place_pairs(
    rows: np.ndarray,
    partners: np.ndarray,
    c1Tw: np.ndarray,
    c2Tw: np.ndarray,
    c2Tc1: np.ndarray,
    uv1: np.ndarray,
    uv2: np.ndarray,
    octave1: np.ndarray,
    octave2: np.ndarray,
    depth1: np.ndarray,
    depth2: np.ndarray,
    right1: np.ndarray,
    right2: np.ndarray,
    sigma1: np.ndarray,
    sigma2: np.ndarray,
    fallback: bool,
    camera: np.ndarray,
    scales: np.ndarray,
    xyz: np.ndarray,
    good: np.ndarray,
) -> None:
    """Triangulate pairs of keypoints, or lift them by measured depth where that has more parallax, and check them.

    A point must lie in front of both keyframes, project to both keypoints, and the ratio of its distances must fit
    the ratio of their pyramid scales.

    Args:
        rows: (M,) int64 keypoints of the first keyframe.
        partners: (M,) int64 keypoints of the second, -1 for none.
        c1Tw: (4, 4) first pose.
        c2Tw: (4, 4) second pose.
        c2Tc1: (4, 4) from the first to the second camera.
        uv1: (N1, 2) float32 pixels; like all that follow, of all keypoints of a keyframe.
        uv2: (N2, 2).
        octave1: (N1,) int32.
        octave2: (N2,).
        depth1: (N1,) float32.
        depth2: (N2,).
        right1: (N1,) float32, column in the right image or -1.
        right2: (N2,).
        sigma1: (N1,) pixels that the error of the depth adds to the noise of ``right1``.
        sigma2: (N2,).
        fallback: Whether keypoints may disagree with the point in their depth alone.
        camera: ``fx, fy, cx, cy, bf``.
        scales: (levels,) scale of every pyramid level.
        xyz: Receives (M, 3) points in the world.
        good: Receives (M,) bool.
    """
    baseline = camera[4] / camera[0]
    tolerance = _SCALE_TOLERANCE * (scales[1] if len(scales) > 1 else 1.2)
    ray1, ray2, point = np.empty((1, 2)), np.empty((1, 2)), np.empty((1, 3))
    p1, p2 = np.empty(3), np.empty(3)
    for m in range(len(rows)):
        good[m] = False
        i, j = rows[m], partners[m]
        if j < 0:
            continue
        for axis in range(2):
            ray1[0, axis] = (uv1[i, axis] - camera[2 + axis]) / camera[axis]
            ray2[0, axis] = (uv2[j, axis] - camera[2 + axis]) / camera[axis]
        stereo1 = _stereo_cosine(depth1[i], right1[i], sigma1[i], baseline)
        stereo2 = _stereo_cosine(depth2[j], right2[j], sigma2[j], baseline)
        measured = min(stereo1, stereo2) < _NO_STEREO
        cosine = _parallax_cosine(c2Tc1, ray1[0], ray2[0])
        if 0 < cosine < min(stereo1, stereo2) and (measured or cosine < _MAX_PARALLAX_COSINE):
            triangulate_into(c2Tc1, ray1, ray2, point)
            _to_world(c1Tw, point[0], xyz[m])
        elif stereo1 < stereo2:
            _lift(uv1[i, 0], uv1[i, 1], depth1[i], c1Tw, camera, p1, xyz[m])
        elif stereo2 < _NO_STEREO:
            _lift(uv2[j, 0], uv2[j, 1], depth2[j], c2Tw, camera, p1, xyz[m])
        else:
            continue
        _to_camera(c1Tw, xyz[m], p1)
        _to_camera(c2Tw, xyz[m], p2)
        scale1, scale2 = scales[octave1[i]], scales[octave2[j]]
        if not _agrees(p1, uv1[i, 0], uv1[i, 1], right1[i], sigma1[i], fallback, scale1, camera):
            continue
        if not _agrees(p2, uv2[j, 0], uv2[j, 1], right2[j], sigma2[j], fallback, scale2, camera):
            continue
        distance1 = math.sqrt(p1[0] * p1[0] + p1[1] * p1[1] + p1[2] * p1[2])
        distance2 = math.sqrt(p2[0] * p2[0] + p2[1] * p2[1] + p2[2] * p2[2])
        ratio = distance2 * scale1 / (distance1 * scale2)
        good[m] = 1.0 / tolerance < ratio < tolerance
