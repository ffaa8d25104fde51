"""Warping of one frame into another with true depth and poses, for tests of the conventions."""

from __future__ import annotations

import cv2
import numpy as np

from prgbd import Sequence


def warp_error(sequence: Sequence, i: int, j: int, shift: float = 0.0, identity: bool = False) -> float:
    """Median absolute grey difference between frame i and frame j warped into it by depth(i) and the poses."""
    camera, depth = sequence.camera, sequence.depth(i)
    first, second = (cv2.GaussianBlur(sequence.frame(k).image.astype(np.float32), (0, 0), 0.7) for k in (i, j))
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    points = camera.backproject(np.stack([u.ravel(), v.ravel()], axis=1), depth.ravel())
    jTi = np.eye(4) if identity else np.linalg.inv(sequence.poses[j]) @ sequence.poses[i]
    moved = points @ jTi[:3, :3].T + jTi[:3, 3]
    ahead = (moved[:, 2] > 0.1).reshape(depth.shape)
    moved[:, 2] = np.maximum(moved[:, 2], 0.1)
    x, y = (camera.project(moved) + shift).reshape(*depth.shape, 2).astype(np.float32).transpose(2, 0, 1)
    inside = ahead & (depth > 0) & (x > 0) & (x < camera.width - 1) & (y > 0) & (y < camera.height - 1)
    assert inside.mean() > 0.2
    warped = cv2.remap(second, x, y, cv2.INTER_LINEAR)
    return float(np.median(np.abs(warped - first)[inside]))
