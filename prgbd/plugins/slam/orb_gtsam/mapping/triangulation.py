"""New points from two keyframes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.epipolar_matching import match_along_epipolar_lines, search_segments
from prgbd.plugins.slam.orb_gtsam.features.extraction import GRID_CELL
from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_LOW
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.geometry.triangulation_kernels import place_pairs
from prgbd.plugins.slam.orb_gtsam.kernels import kernel
from prgbd.plugins.slam.orb_gtsam.map.map import Map

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# ORB-SLAM2 (LocalMapping::CreateNewMapPoints): ratio test when new points are triangulated.
RATIO = 0.6
_LEAST_BASELINE_OF_DEPTH = 0.01
# Partners are looked for up to this share of the depth that all but 5 % of the keyframe's points exceed.
_NEAREST_SHARE = 0.5
_NEAREST_PERCENTILE = 5.0


def create_points(slam_map: Map, camera: CameraModel, k: int, other: int) -> IntArray:
    """Triangulate keypoints of keyframe ``k`` that have no point with those of ``other``.

    Returns:
        The new points.
    """
    none = np.zeros(0, np.int64)
    if not _far_enough(slam_map, camera, k, other):
        return none
    c1Tw, c2Tw = slam_map.keyframes.cTw[k], slam_map.keyframes.cTw[other]
    c2Tc1 = c2Tw @ inverse(c1Tw)
    first, second = slam_map.features(k), slam_map.features(other)
    rows = np.flatnonzero(slam_map.points_of(k) < 0)
    partners = _match(slam_map, camera, k, other, rows, c2Tc1)
    xyz, good = np.empty((len(rows), 3)), np.empty(len(rows), np.bool_)
    place_pairs(
        rows,
        partners,
        c1Tw,
        c2Tw,
        c2Tc1,
        first.uv,
        second.uv,
        first.octave,
        second.octave,
        first.depth,
        second.depth,
        first.u_right,
        second.u_right,
        camera.right_sigma(first.depth),
        camera.right_sigma(second.depth),
        camera.noise.fallback,
        np.array(camera.intrinsics),
        camera.scales,
        xyz,
        good,
    )
    kept = np.flatnonzero(good)
    if len(kept) == 0:
        return none
    ids = slam_map.add_points(k, rows[kept], xyz[kept])
    slam_map.observe(other, partners[kept], ids)
    return ids


def _far_enough(slam_map: Map, camera: CameraModel, k: int, other: int) -> bool:
    kf = slam_map.keyframes
    distance = float(np.linalg.norm(kf.centre[k] - kf.centre[other]))
    if not camera.mono and camera.noise.is_zero:
        return distance >= camera.baseline
    return distance >= _LEAST_BASELINE_OF_DEPTH * _depth(slam_map, other, 50.0) > 0


def _depth(slam_map: Map, k: int, percentile: float) -> float:
    """Percentile of the depths of the points that keyframe ``k`` sees, 0 without points."""
    cTw = slam_map.keyframes.cTw[k]
    return float(_depth_percentile(slam_map.points_of(k), slam_map.points.xyz, cTw, percentile))


@kernel()
def _depth_percentile(points: np.ndarray, xyz: np.ndarray, cTw: np.ndarray, percentile: float) -> float:
    depths = np.empty(len(points))
    n = 0
    for p in points:
        if p >= 0:
            depths[n] = cTw[2, 0] * xyz[p, 0] + cTw[2, 1] * xyz[p, 1] + cTw[2, 2] * xyz[p, 2] + cTw[2, 3]
            n += 1
    if n == 0:
        return 0.0
    position = 0.01 * percentile * (n - 1)
    depths = np.sort(depths[:n])
    low = int(position)
    high = min(low + 1, n - 1)
    return depths[low] + (position - low) * (depths[high] - depths[low])


def _match(slam_map: Map, camera: CameraModel, k: int, other: int, rows: IntArray, c2Tc1: FloatArray) -> IntArray:
    """Match keypoints without points along epipolar lines; -1 where there is no partner."""
    tx, ty, tz = c2Tc1[:3, 3]
    cross = np.array([[0.0, -tz, ty], [tz, 0.0, -tx], [-ty, tx, 0.0]])
    Kinv = np.linalg.inv(camera.pinhole.K)
    F = Kinv.T @ cross @ c2Tc1[:3, :3] @ Kinv
    # A camera centre beside the other one has its epipole at infinity.
    epipole = np.full(2, 1e9)
    if tz > 1e-6:
        epipole = np.array(
            [camera.pinhole.fx * tx / tz + camera.pinhole.cx, camera.pinhole.fy * ty / tz + camera.pinhole.cy]
        )
    first, second = slam_map.features(k), slam_map.features(other)
    nearest = _NEAREST_SHARE * _depth(slam_map, k, _NEAREST_PERCENTILE)
    partners: IntArray = match_along_epipolar_lines(
        rows,
        first.uv,
        first.descriptor,
        first.angle,
        second.uv,
        second.octave,
        second.descriptor,
        second.angle,
        second.cell_start,
        slam_map.points_of(other) >= 0,
        camera.columns,
        GRID_CELL,
        F,
        search_segments(rows, first.uv, c2Tc1, np.array(camera.intrinsics), nearest),
        epipole,
        camera.scales,
        DISTANCE_LOW,
        RATIO,
    )
    return partners
