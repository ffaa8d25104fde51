"""New points from two keyframes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.features import GRID_CELL, Features
from prgbd.plugins.slam.orb_gtsam.lie import inverse
from prgbd.plugins.slam.orb_gtsam.mapping import Map
from prgbd.plugins.slam.orb_gtsam.matching import match_along_epipolar_lines
from prgbd.plugins.slam.orb_gtsam.reprojection import CHI2_MONO, CHI2_STEREO
from prgbd.plugins.slam.orb_gtsam.rig import Rig
from prgbd.plugins.slam.orb_gtsam.settings import Settings
from prgbd.plugins.slam.orb_gtsam.two_view import triangulate_pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# ORB-SLAM2 (LocalMapping::CreateNewMapPoints).
_MAX_PARALLAX_COSINE = 0.9998
_SCALE_TOLERANCE = 1.5
_LEAST_BASELINE_OF_DEPTH = 0.01
# Partners are looked for up to this share of the depth that all but 5 % of the keyframe's points exceed.
_NEAREST_SHARE = 0.5
_NEAREST_PERCENTILE = 5.0


def create_points(world: Map, rig: Rig, settings: Settings, k: int, other: int) -> IntArray:
    """Triangulate keypoints of keyframe ``k`` that have no point with those of ``other``.

    Returns:
        The new points.
    """
    none = np.zeros(0, np.int64)
    if not _far_enough(world, rig, k, other):
        return none
    rows, partners = _match(world, rig, settings, k, other)
    if len(rows) == 0:
        return none
    c1Tw, c2Tw = world.keyframes.cTw[k], world.keyframes.cTw[other]
    first, second = world.features(k), world.features(other)
    rays1, rays2 = rig.rays(first.uv[rows]), rig.rays(second.uv[partners])
    cosine = _parallax_cosine(c1Tw, c2Tw, rays1, rays2)
    stereo1 = _stereo_cosine(rig, first, rows)
    stereo2 = _stereo_cosine(rig, second, partners)
    stereo = np.minimum(stereo1, stereo2)
    measured = (stereo1 < 2.0) | (stereo2 < 2.0)
    by_rays = (cosine < stereo) & (cosine > 0) & (measured | (cosine < _MAX_PARALLAX_COSINE))
    by_first = ~by_rays & (stereo1 < stereo2) & (stereo1 < 2.0)
    by_second = ~by_rays & ~by_first & (stereo2 < 2.0)
    xyz = triangulate_pairs(c1Tw, c2Tw, rays1, rays2)
    if by_first.any():
        xyz[by_first] = rig.lift(first, rows[by_first], inverse(c1Tw))
    if by_second.any():
        xyz[by_second] = rig.lift(second, partners[by_second], inverse(c2Tw))
    good = (by_rays | by_first | by_second) & np.isfinite(xyz).all(axis=1)
    xyz[~good] = 0.0
    good &= _agrees(rig, first, rows, xyz, c1Tw) & _agrees(rig, second, partners, xyz, c2Tw)
    good &= _scale_agrees(world, rig, k, other, first.octave[rows], second.octave[partners], xyz)
    kept = np.flatnonzero(good)
    ids = world.add_points(k, rows[kept], xyz[kept])
    world.observe(other, partners[kept], ids)
    return ids


def _far_enough(world: Map, rig: Rig, k: int, other: int) -> bool:
    kf = world.keyframes
    distance = float(np.linalg.norm(kf.centre[k] - kf.centre[other]))
    if not rig.mono:
        return distance >= rig.baseline
    return distance >= _LEAST_BASELINE_OF_DEPTH * _depth(world, other, 50.0) > 0


def _depth(world: Map, k: int, percentile: float) -> float:
    """Percentile of the depths of the points that keyframe ``k`` sees, 0 without points."""
    points = world.points_of(k)
    points = points[points >= 0]
    if len(points) == 0:
        return 0.0
    cTw = world.keyframes.cTw[k]
    return float(np.percentile(world.points.xyz[points] @ cTw[2, :3] + cTw[2, 3], percentile))


def _match(world: Map, rig: Rig, settings: Settings, k: int, other: int) -> tuple[IntArray, IntArray]:
    """Match keypoints without points along epipolar lines."""
    c2Tc1 = world.keyframes.cTw[other] @ inverse(world.keyframes.cTw[k])
    tx, ty, tz = c2Tc1[:3, 3]
    cross = np.array([[0.0, -tz, ty], [tz, 0.0, -tx], [-ty, tx, 0.0]])
    Kinv = np.linalg.inv(rig.camera.K)
    F = Kinv.T @ cross @ c2Tc1[:3, :3] @ Kinv
    # A camera centre beside the other one has its epipole at infinity.
    epipole = np.full(2, 1e9)
    if tz > 1e-6:
        epipole = np.array([rig.camera.fx * tx / tz + rig.camera.cx, rig.camera.fy * ty / tz + rig.camera.cy])
    first, second = world.features(k), world.features(other)
    rows = np.flatnonzero(world.points_of(k) < 0)
    nearest = _NEAREST_SHARE * _depth(world, k, _NEAREST_PERCENTILE)
    partners = match_along_epipolar_lines(
        rows,
        first.uv,
        first.descriptor,
        first.angle,
        second.uv,
        second.octave,
        second.descriptor,
        second.angle,
        second.cell_start,
        world.points_of(other) >= 0,
        rig.columns,
        GRID_CELL,
        F,
        _segments(rig, first, rows, c2Tc1, nearest),
        epipole,
        rig.scales,
        settings.distance_low,
        settings.ratio_triangulation,
    )
    matched = partners >= 0
    return rows[matched], partners[matched]


def _segments(rig: Rig, features: Features, rows: IntArray, c2Tc1: FloatArray, nearest: float) -> FloatArray:
    """Return where keypoints may lie in the other image, (M, 4): their pixels at infinity and at ``nearest`` depth."""
    rays = np.column_stack([rig.rays(features.uv[rows]), np.ones(len(rows))]) @ c2Tc1[:3, :3].T
    c = rig.camera
    ends = np.empty((len(rows), 4))
    for first, p in ((0, rays), (2, rays * nearest + c2Tc1[:3, 3])):
        # What lies beside or behind the other camera leaves that end of the line open.
        z = p[:, 2]
        open_end = np.where(p[:, :2] >= 0, 1e9, -1e9)
        front = z > 1e-3 * (nearest if first else 1.0)
        safe = np.where(front, z, 1.0)
        ends[:, first] = np.where(front, c.fx * p[:, 0] / safe + c.cx, open_end[:, 0])
        ends[:, first + 1] = np.where(front, c.fy * p[:, 1] / safe + c.cy, open_end[:, 1])
    return ends


def _parallax_cosine(c1Tw: FloatArray, c2Tw: FloatArray, rays1: FloatArray, rays2: FloatArray) -> FloatArray:
    world1 = np.column_stack([rays1, np.ones(len(rays1))]) @ c1Tw[:3, :3]
    world2 = np.column_stack([rays2, np.ones(len(rays2))]) @ c2Tw[:3, :3]
    lengths = np.linalg.norm(world1, axis=1) * np.linalg.norm(world2, axis=1)
    return np.asarray((world1 * world2).sum(axis=1) / lengths)


def _stereo_cosine(rig: Rig, features: Features, rows: IntArray) -> FloatArray:
    """Cosine of the parallax that the (virtual) stereo pair gives; 2 without depth."""
    depth = features.depth[rows].astype(np.float64)
    seen = features.u_right[rows] >= 0
    angle = 2.0 * np.arctan2(0.5 * rig.baseline, np.where(depth > 0, depth, 1.0))
    return np.where(seen & (depth > 0), np.cos(angle), 2.0)


def _agrees(rig: Rig, features: Features, rows: IntArray, xyz: FloatArray, cTw: FloatArray) -> NDArray[np.bool_]:
    """Whether points lie in front of a keyframe and project to their keypoints by the chi-square test."""
    p = xyz @ cTw[:3, :3].T + cTw[:3, 3]
    front = p[:, 2] > 1e-6
    p[~front] = (0.0, 0.0, 1.0)
    uv = rig.camera.project(p)
    weight = rig.inverse_variance[features.octave[rows]]
    square = ((uv - features.uv[rows]) ** 2).sum(axis=1)
    u_right = features.u_right[rows]
    stereo = u_right >= 0
    square = square + np.where(stereo, (uv[:, 0] - rig.bf / p[:, 2] - u_right) ** 2, 0.0)
    return np.asarray(front & (square * weight <= np.where(stereo, CHI2_STEREO, CHI2_MONO)))


def _scale_agrees(
    world: Map, rig: Rig, k: int, other: int, octave1: NDArray[np.int32], octave2: NDArray[np.int32], xyz: FloatArray
) -> NDArray[np.bool_]:
    """Whether the ratio of distances fits the ratio of pyramid scales."""
    kf = world.keyframes
    distance1 = np.linalg.norm(xyz - kf.centre[k], axis=1)
    distance2 = np.linalg.norm(xyz - kf.centre[other], axis=1)
    ratio = distance2 * rig.scales[octave1] / np.maximum(distance1 * rig.scales[octave2], 1e-12)
    tolerance = _SCALE_TOLERANCE * (rig.scales[1] if len(rig.scales) > 1 else 1.2)
    return np.asarray((ratio > 1.0 / tolerance) & (ratio < tolerance) & (distance1 > 0))
