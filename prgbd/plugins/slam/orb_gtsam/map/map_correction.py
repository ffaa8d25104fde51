"""Moving a map: keyframes to new poses and units, and everything that hangs on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.map import Map

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Correction:
    """New poses of keyframes.

    Attributes:
        keyframes: (K,) int64, all of one map.
        wTc: (K, 4, 4) new poses, in the new units.
        scale: (K,) new units per old one around each keyframe.
    """

    keyframes: IntArray
    wTc: FloatArray
    scale: FloatArray


def apply(slam_map: Map, anchor: int, correction: Correction) -> None:
    """Move keyframes, and points with their reference keyframes; the caller holds ``Map.lock``.

    Keyframes that came after the correction was computed follow keyframe ``anchor``.
    """
    kf, pts = slam_map.keyframes, slam_map.points
    map_id = int(kf.map_id[anchor])
    points = slam_map.seen_by(slam_map.alive(map_id))
    slam_map.refresh(points)  # so that every reference keyframe is there
    # Where every keyframe's camera coordinates go: x -> scale R x + t.
    wSc = np.broadcast_to(np.eye(4), (kf.count, 4, 4)).copy()
    scale = np.ones(kf.count)
    wSc[correction.keyframes], scale[correction.keyframes] = correction.wTc, correction.scale
    new = np.setdiff1d(slam_map.alive(map_id), correction.keyframes)
    relative = kf.cTw[anchor] @ inverse(kf.cTw[new])
    relative[:, :3, 3] *= scale[anchor]
    wSc[new], scale[new] = wSc[anchor] @ relative, scale[anchor]
    reference = pts.reference[points]
    in_camera = np.einsum("nij,nj->ni", kf.cTw[reference, :3, :3], pts.xyz[points]) + kf.cTw[reference, :3, 3]
    in_camera *= scale[reference, None]
    pts.xyz[points] = np.einsum("nij,nj->ni", wSc[reference, :3, :3], in_camera) + wSc[reference, :3, 3]
    for k in slam_map.alive(map_id).tolist():
        slam_map.set_pose(k, inverse(wSc[k]))
    _rescale(slam_map, map_id, scale)
    slam_map.refresh(points)


def carry_late_keyframes(slam_map: Map, k: int, before: FloatArray, count: int) -> None:
    """Move keyframes that came while ``k`` was adjusted, and their points, with it; the caller holds ``Map.lock``.

    Args:
        slam_map: The map.
        k: The adjusted keyframe, at its new pose.
        before: (4, 4) ``cTw`` of ``k`` when its adjustment began.
        count: How many keyframes there were then.
    """
    kf, pts = slam_map.keyframes, slam_map.points
    late = [n for n in range(count, kf.count) if kf.map_id[n] == kf.map_id[k]]
    if not late:
        return
    oldTnew = inverse(before) @ kf.cTw[k]
    newTold = inverse(oldTnew)
    for n in late:
        slam_map.set_pose(n, kf.cTw[n] @ oldTnew)
        own = slam_map.points_of(n)
        own = own[own >= 0]
        own = own[pts.created[own] == n]
        pts.xyz[own] = pts.xyz[own] @ newTold[:3, :3].T + newTold[:3, 3]


def carry_lone_points(slam_map: Map, lone: IntArray, before: FloatArray) -> None:
    """Move points that one keyframe alone sees with it; the caller holds ``Map.lock``.

    Args:
        slam_map: The map.
        lone: (M, 2) rows ``(keyframe, point)``.
        before: (K, 4, 4) ``cTw`` of all keyframes before they moved.
    """
    if len(lone) == 0:
        return
    xyz, (at, points) = slam_map.points.xyz, lone.T
    oldTnew = inverse(before[at]) @ slam_map.keyframes.cTw[at]
    newTold = inverse(oldTnew)
    xyz[points] = np.einsum("nij,nj->ni", newTold[:, :3, :3], xyz[points]) + newTold[:, :3, 3]


def _rescale(slam_map: Map, map_id: int, scale: FloatArray) -> None:
    """Note that the map changed its units around every keyframe, and give culled ones the units of their place."""
    kf = slam_map.keyframes
    for k in np.flatnonzero(kf.map_id[: kf.count] == map_id).tolist():
        s = float(scale[slam_map.successor(k)])
        kf.scale[k] *= s
        kf.cTparent[k, :3, 3] *= s


def follow_baseline(slam_map: Map, camera: CameraModel) -> None:
    """Move the right columns of all keyframes to where the camera's baseline puts them; the caller holds the lock."""
    kf = slam_map.keyframes
    measured = (kf.u_right[: kf.count] >= 0) & (kf.depth[: kf.count] > 0)
    right = kf.uv[: kf.count, :, 0] - np.float32(camera.bf) / np.where(measured, kf.depth[: kf.count], 1)
    kf.u_right[: kf.count][measured] = right[measured]
