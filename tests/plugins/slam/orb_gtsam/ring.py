"""A made-up drive around a ring of points, as a map that drifted and does not know yet that its ends meet."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import GRID_CELL, Features
from prgbd.plugins.slam.orb_gtsam.features.feature_kernels import cell_order
from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, inverse
from prgbd.plugins.slam.orb_gtsam.loop_closing.loop_closer import LoopCloser
from prgbd.plugins.slam.orb_gtsam.map.adjustment import MapAdjuster
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.optimisation.make_solver import make_solver
from prgbd.plugins.slam.orb_gtsam.settings import LoopClosingOptions, Settings

CAPACITY, RADIUS, LAP = 300, 20.0, 60
CAMERA = PinholeCamera(640, 480, 400.0, 400.0, 320.0, 240.0)
COLUMNS, ROWS = int(np.ceil(640 / GRID_CELL)), int(np.ceil(480 / GRID_CELL))


class ExactDatabase:
    """Stands in for ``KeyframeDatabase``: the score is the share of equal descriptors."""

    def __init__(self) -> None:
        self.known: dict[int, set[bytes]] = {}

    def add(self, k: int, descriptors: np.ndarray) -> None:
        self.known[k] = {d.tobytes() for d in descriptors}

    def query(self, descriptors: np.ndarray, *, exclude=()) -> tuple[np.ndarray, np.ndarray]:
        asked = {d.tobytes() for d in descriptors}
        scores = {k: len(asked & have) / len(asked) for k, have in self.known.items() if k not in exclude}
        order = sorted((k for k in scores if scores[k] > 0), key=lambda k: (-scores[k], k))
        return np.array(order, np.int64), np.array([scores[k] for k in order])


def true_pose(step: float) -> np.ndarray:
    """Return ``wTc`` of a camera that looks along the ring."""
    angle = 2 * np.pi * step / LAP
    x, z = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
    wTc = np.eye(4)
    wTc[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    wTc[:3, 3] = RADIUS * x
    return wTc


@dataclass
class Ring:
    """The map under construction, and the truth.

    Attributes:
        drift: Log of scale and yaw that one keyframe adds.
        seed: Of the scene and the noise.
        mono: Whether there is no depth.
    """

    drift: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    mono: bool = True
    scale: float = 1.0
    truth: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.settings = Settings(loop_closing=LoopClosingOptions(min_interval=5))
        self.camera = CameraModel(
            CAMERA, self.mono, 0.0 if self.mono else 0.1, 0.0, self.settings.features.scales(), COLUMNS
        )
        self.map = Map(CAPACITY, COLUMNS * ROWS, self.camera.scales)
        self.covisibility = CovisibilityGraph(self.map)
        options, solver = self.settings.optimisation, make_solver("numba")
        adjuster = MapAdjuster(options, self.camera, self.map, self.covisibility, solver)
        self.database = ExactDatabase()
        self.closer = LoopCloser(self.settings, self.camera, self.map, self.covisibility, adjuster, self.database)
        self.rng = np.random.default_rng(self.seed)
        n = 4000
        angle, radius = self.rng.uniform(0, 2 * np.pi, n), RADIUS + self.rng.uniform(-7, 7, n)
        self.xyz = np.stack([radius * np.cos(angle), self.rng.uniform(-4, 4, n), radius * np.sin(angle)], axis=1)
        self.descriptor = self.rng.integers(0, 2**63, (n, 4), dtype=np.int64).astype(np.uint64)
        self.map_point = np.full(n, -1, np.int64)
        self.last_seen = np.full(n, -(1 << 30))
        self.estimate = true_pose(0)

    def see(self, wTc: np.ndarray) -> tuple[np.ndarray, Features, np.ndarray]:
        """Return the scene points that a camera sees, its keypoints and their true camera coordinates."""
        local = (self.xyz - wTc[:3, 3]) @ wTc[:3, :3]
        ahead = np.flatnonzero((local[:, 2] > 3) & (local[:, 2] < 14))
        uv = CAMERA.project(local[ahead]) + self.rng.normal(0, 0.2, (len(ahead), 2))
        ahead, uv = ahead[(inside := np.all((uv > 5) & (uv < [635, 475]), axis=1))][:CAPACITY], uv[inside][:CAPACITY]
        order, start = cell_order(uv.astype(np.float32), COLUMNS, ROWS, GRID_CELL)
        ahead, uv = ahead[order], np.ascontiguousarray(uv[order], np.float32)
        depth = local[ahead, 2].astype(np.float32)
        # A point keeps its size: half as far is four levels of 1.2 finer.
        octave = np.clip(np.round(np.log(14 / depth) / np.log(1.2)), 0, 7).astype(np.int32)
        n = len(ahead)
        depth = np.zeros(n, np.float32) if self.mono else depth
        right = np.full(n, -1, np.float32) if self.mono else (uv[:, 0] - self.camera.bf / depth).astype(np.float32)
        features = Features(
            uv,
            octave,
            np.zeros(n, np.float32),
            np.ascontiguousarray(self.descriptor[ahead]),
            depth,
            right,
            np.zeros((n, 3), np.uint8),
            start,
        )
        return ahead, features, local[ahead]

    def drive(self, step: int) -> int:
        """Add the keyframe of a step of the ring, with the drift; return its number."""
        wTc = true_pose(step)
        if self.truth:
            motion = inverse(self.truth[-1]) @ wTc
            motion[:3, 3] *= self.scale
            self.scale *= np.exp(self.drift[0])
            turn = exp_se3(np.array([0, self.drift[1], 0, 0, 0, 0]))
            self.estimate = self.estimate @ motion @ turn
        self.truth.append(wTc)
        seen, features, local = self.see(wTc)
        # What has not been seen for a while is new to the map.
        self.map_point[seen[step - self.last_seen[seen] > 12]] = -1
        self.last_seen[seen] = step
        points = self.map.current(self.map_point[seen])
        k = self.map.add_keyframe(len(self.truth) - 1, 0.1 * step, inverse(self.estimate), features, points)
        new = np.flatnonzero(points < 0)
        xyz = self.scale * local[new] @ self.estimate[:3, :3].T + self.estimate[:3, 3]
        self.map_point[seen] = points
        self.map_point[seen[new]] = self.map.add_points(k, new, xyz)
        own = self.map.points_of(k)
        self.map.refresh(own[own >= 0])
        self.covisibility.clear()
        return k

    def close_loops(self, k: int) -> bool:
        """Let the loop closer have keyframe ``k``, and remember the place."""
        before = inverse(self.map.keyframes.cTw[k])
        closed = self.closer.process(k)
        after = inverse(self.map.keyframes.cTw[k])
        if closed:
            self.estimate = after
            self.scale *= self.map.keyframes.scale[k]
        else:
            np.testing.assert_array_equal(before, after)
        self.database.add(k, self.map.features(k).descriptor)
        return closed

    def error(self) -> float:
        """Return the RMSE of the keyframes' centres after alignment by a similarity."""
        from prgbd.plugins.slam.orb_gtsam.geometry.sim3 import align

        kf = self.map.keyframes
        alive = np.flatnonzero(~kf.bad[: kf.count])
        centres, truth = kf.centre[alive], np.stack([self.truth[k][:3, 3] for k in alive])
        S = align(truth, centres, free_scale=True)
        return float(np.sqrt(np.mean(np.sum((centres @ S[:3, :3].T + S[:3, 3] - truth) ** 2, axis=1))))
