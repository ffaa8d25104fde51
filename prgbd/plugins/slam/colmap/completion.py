"""What COLMAP leaves open: the scale, where depth was given, and the frames between its keyframes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.colmap.reconstruction import Model

MIN_DEPTHS = 20
"""Fewer measured depths than this fix no scale."""


def from_first_camera(model: Model) -> Model:
    """Return the model in the coordinates of its first camera."""
    cTw = np.linalg.inv(model.wTc[0])
    return replace(model, wTc=cTw @ model.wTc, xyz=model.xyz @ cTw[:3, :3].T + cTw[:3, 3])


def depth_scale(model: Model, depth: NDArray[np.float32]) -> float | None:
    """Return the median ratio of given depth to the model's depth over all observations.

    Args:
        model: The model.
        depth: (M,) given depth at every observation, 0 where there is none.

    Returns:
        The factor on the model, or None with fewer than ``MIN_DEPTHS`` depths.
    """
    cTw = np.linalg.inv(model.wTc)[model.keyframe]
    z = np.einsum("mi,mi->m", cTw[:, 2, :3], model.xyz[model.point]) + cTw[:, 2, 3]
    known = (depth > 0) & (z > 0)
    if np.count_nonzero(known) < MIN_DEPTHS:
        return None
    return float(np.median(depth[known] / z[known]))


def scaled(model: Model, scale: float) -> Model:
    """Return the model times ``scale``."""
    wTc = model.wTc.copy()
    wTc[:, :3, 3] *= scale
    return replace(model, wTc=wTc, xyz=model.xyz * scale)


def interpolate(
    frame_index: NDArray[np.int64], wTc: NDArray[np.float64], stamps: NDArray[np.float64], gap: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Put frames between registered neighbours: positions on the line, rotations on the arc, by time.

    Args:
        frame_index: (K,) ascending registered frames.
        wTc: (K, 4, 4) their poses.
        stamps: (N,) seconds of all frames.
        gap: Nothing is put between frames farther apart than this.

    Returns:
        The frames with a pose, (F,) ascending, and their poses, (F, 4, 4); registered ones keep theirs.
    """
    from scipy.spatial.transform import Rotation, Slerp

    if len(frame_index) < 2:
        return frame_index, wTc
    steps = np.diff(frame_index)
    inner = [np.arange(a + 1, a + n) for a, n in zip(frame_index, steps, strict=False) if 1 < n <= gap]
    frames = np.sort(np.concatenate([frame_index, *inner])).astype(np.int64)
    known, at = stamps[frame_index], stamps[frames]
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, :3, :3] = Slerp(known, Rotation.from_matrix(wTc[:, :3, :3]))(at).as_matrix()
    for axis in range(3):
        poses[:, axis, 3] = np.interp(at, known, wTc[:, axis, 3])
    poses[np.searchsorted(frames, frame_index)] = wTc
    return frames, poses
