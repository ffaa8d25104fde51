"""A cloud of points with unmistakable descriptors, and keyframes and frames that see it: maps made by hand."""

from __future__ import annotations

import numpy as np

from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.camera.depth_noise import DepthNoise
from prgbd.plugins.slam.orb_gtsam.features.extraction import GRID_CELL, Features
from prgbd.plugins.slam.orb_gtsam.features.feature_kernels import cell_order
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.settings import Settings

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 320.0, 240.0)
COLUMNS, ROWS = int(np.ceil(640 / GRID_CELL)), int(np.ceil(480 / GRID_CELL))
BASELINE, CLOSE = 0.1, 8.0


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return ``cTw`` of a camera at a place that looks along z."""
    cTw = np.eye(4)
    cTw[:3, 3] = (-x, -y, -z)
    return cTw


class Cloud:
    """Points 6 to 10 metres ahead of the origin that all cameras near it see, and an empty map.

    Attributes:
        xyz: (N, 3) the points.
        descriptor: (N, 4) uint64.
    """

    def __init__(
        self, points: int = 80, *, mono: bool = False, noise: DepthNoise | None = None, seed: int = 0, **options: object
    ) -> None:
        rng = np.random.default_rng(seed)
        self.xyz = np.stack([rng.uniform(-2, 2, points), rng.uniform(-1.5, 1.5, points), rng.uniform(6, 10, points)], 1)
        self.descriptor = rng.integers(0, 2**63, (points, 4), dtype=np.int64).astype(np.uint64)
        self.settings = Settings.from_options(options)
        self.camera = CameraModel(
            CAMERA, mono, 0.0 if mono else BASELINE, CLOSE, 1.2 ** np.arange(8), COLUMNS, noise=noise or DepthNoise()
        )
        self.map = Map(points, COLUMNS * ROWS, self.camera.scales)
        self.covisibility = CovisibilityGraph(self.map, 15)

    def see(
        self, cTw: np.ndarray, which: np.ndarray | None = None, depth_factor: float = 1.0
    ) -> tuple[Features, np.ndarray]:
        """Return the exact keypoints of some points (all by default), and which point each of them shows."""
        shown = np.arange(len(self.xyz)) if which is None else which
        local = self.xyz[shown] @ cTw[:3, :3].T + cTw[:3, 3]
        uv = CAMERA.project(local).astype(np.float32)
        order, start = cell_order(uv, COLUMNS, ROWS, GRID_CELL)
        uv, shown, n = np.ascontiguousarray(uv[order]), shown[order], len(shown)
        depth, right = np.zeros(n, np.float32), np.full(n, -1.0, np.float32)
        if not self.camera.mono:
            depth = (depth_factor * local[order, 2]).astype(np.float32)
            right = (uv[:, 0] - self.camera.bf / depth).astype(np.float32)
        return Features(
            uv,
            np.zeros(n, np.int32),
            np.zeros(n, np.float32),
            np.ascontiguousarray(self.descriptor[shown]),
            depth,
            right,
            np.zeros((n, 3), np.uint8),
            start,
        ), shown

    def keyframe(self, cTw: np.ndarray, point_of: np.ndarray | None = None) -> tuple[int, np.ndarray]:
        """Add a keyframe that observes the map points ``point_of`` ((N,) for the cloud, -1: none); return it, and rows.

        The second result is (N,) int64, the keypoint that shows each point of the cloud.
        """
        features, shown = self.see(cTw)
        points = np.full(len(shown), -1, np.int64) if point_of is None else point_of[shown]
        k = self.map.add_keyframe(self.map.keyframes.count, 0.1 * self.map.keyframes.count, cTw, features, points)
        return k, np.argsort(shown)

    def place(self, k: int, rows: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Give some points of the cloud, which keyframe ``k`` sees at ``rows``, their true place in the map.

        Returns:
            (N,) int64, the map point of every point of the cloud, -1 for the others.
        """
        points = np.full(len(self.xyz), -1, np.int64)
        points[which] = self.map.add_points(k, rows[which], self.xyz[which])
        self.map.refresh(points[which])
        return points
