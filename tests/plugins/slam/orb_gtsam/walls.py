"""A made-up room for the tests of tracking: two textured walls at different depths, with exact depth and poses."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from prgbd.core.types import Frame, PinholeCamera

CAMERA = PinholeCamera.from_fov(320, 240, 60.0)
_PIXELS_PER_METRE = 75.0
_WALLS = ((2.0, -np.inf, 0.0), (3.5, -np.inf, np.inf))


@lru_cache
def _texture(wall: int) -> np.ndarray:
    rng = np.random.default_rng(wall)
    blocks = np.kron(rng.integers(0, 256, (350, 350, 3), dtype=np.uint8), np.ones((4, 4, 1))).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(blocks, (3, 3), 0.6))


def pose(x: float, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """Return ``wTc`` of a camera at a place, turned about its vertical axis by ``yaw`` radians."""
    wTc = np.eye(4)
    wTc[:3, :3] = cv2.Rodrigues(np.array([0.0, yaw, 0.0]))[0]
    wTc[:3, 3] = (x, y, z)
    return wTc


def view(index: int, wTc: np.ndarray, camera: PinholeCamera = CAMERA) -> Frame:
    """Render the walls from a pose."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    in_world = rays @ wTc[:3, :3].T
    depth = np.zeros(u.shape)
    image = np.zeros((*u.shape, 3), np.uint8)
    for number, (z, left, right) in enumerate(_WALLS):
        scale = (z - wTc[2, 3]) / in_world[..., 2]
        x, y = in_world[..., 0] * scale + wTc[0, 3], in_world[..., 1] * scale + wTc[1, 3]
        hit = (scale > 0) & (x > left) & (x < right) & (depth == 0)
        at = [((c * _PIXELS_PER_METRE) + 700.0).astype(np.float32) for c in (x, y)]
        shown = cv2.remap(_texture(number), *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        image[hit], depth[hit] = shown[hit], scale[hit]
    return Frame(index, index * 0.1, image, depth.astype(np.float32))


def path(count: int) -> list[np.ndarray]:
    """Return poses of a hand-held walk to the side, up and down and towards the walls."""
    t = np.arange(count)
    return [pose(0.02 * i, 0.03 * np.sin(0.3 * i), 0.006 * i, 0.02 * np.sin(0.15 * i)) for i in t.tolist()]


def error(estimate: np.ndarray, truth: np.ndarray, *, scale: bool) -> float:
    """Return the root mean square distance of positions (N, 3) after alignment (Umeyama)."""
    a, b = estimate - estimate.mean(0), truth - truth.mean(0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.linalg.det(U @ Vt)])
    s = np.trace(np.diag(S) @ sign) / (a**2).sum() if scale else 1.0
    return float(np.sqrt((((s * a @ (U @ sign @ Vt).T) - b) ** 2).sum(axis=1).mean()))
