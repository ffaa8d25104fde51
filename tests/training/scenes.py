"""A small world for the training tests: true poses and points of a camera before a textured, tilted wall."""

from __future__ import annotations

import numpy as np

from prgbd.core.data import Sequence
from prgbd.core.types import Frame, Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory


class WallSequence(Sequence):
    """A camera that drifts along the wall ``0.25 x - 0.15 y + z = 5``, with exact depth, the same in every frame."""

    normal, offset = np.array([0.25, -0.15, 1.0]), 5.0

    def __init__(self, frames: int = 12, width: int = 96, height: int = 64, step: float = 0.08, name: str = "wall"):
        self.name = name
        self.camera = PinholeCamera.from_fov(width, height, 70)
        self.timestamps = np.arange(frames) / 10
        self.reads = 0
        self._poses = np.tile(np.eye(4), (frames, 1, 1))
        self._poses[:, 0, 3] = step * np.arange(frames)
        self._poses[:, 2, 3] = -0.25 * step * np.arange(frames)

    @property
    def poses(self):
        return self._poses

    def _points(self, index):
        v, u = np.mgrid[: self.camera.height, : self.camera.width].astype(float)
        rays = self.camera.backproject(np.stack([u.ravel(), v.ravel()], 1), np.ones(u.size))
        origin = self._poses[index][:3, 3]
        depth = (self.offset - self.normal @ origin) / (rays @ self.normal)
        return origin + rays * depth[:, None], depth

    def depth(self, index):
        return self._points(index)[1].reshape(self.camera.height, self.camera.width).astype(np.float32)

    def frame(self, index):
        self.reads += 1
        points, _ = self._points(index)
        waves = [0.5 + 0.22 * np.sin(5 * points[:, 0] + c) + 0.22 * np.cos(6 * points[:, 1] - 2 * c) for c in range(3)]
        image = (255 * np.stack(waves, 1)).clip(0, 255).astype(np.uint8)
        shape = (self.camera.height, self.camera.width, 3)
        return Frame(index, float(self.timestamps[index]), image.reshape(shape))


def true_slam_result(
    sequence, every=3, points=150, seed=0, mode="rgbd", scale=1.0, map_of=None, lost=(), max_depth=60.0
) -> SlamResult:
    """What SLAM would return if it made no error: keyframes every few frames, points seen where they project.

    Works for any sequence with true poses and depth. ``scale`` multiplies the world, ``lost`` frames have no pose,
    ``map_of`` gives the map of each keyframe, and points are made no farther than ``max_depth`` metres.
    """
    rng = np.random.default_rng(seed)
    camera, poses = sequence.camera.undistorted(), sequence.poses.copy()
    frames = np.array([i for i in range(len(sequence)) if i not in lost])
    rows = np.array([i for i in range(0, len(sequence), every) if i not in lost])
    depths = {int(f): sequence.depth(int(f)) for f in rows}
    xyz = np.concatenate([_drawn(camera, poses[f], depths[int(f)], points, rng, max_depth) for f in rows])
    seen = [_visible(camera, poses[f], depths[int(f)], xyz) for f in rows]
    poses[:, :3, 3] *= scale
    observations = Observations(
        keyframe=np.repeat(np.arange(len(rows)), [len(s[0]) for s in seen]),
        point=np.concatenate([s[0] for s in seen]),
        uv=np.concatenate([s[1] for s in seen]).astype(np.float32),
        depth=np.concatenate([s[2] for s in seen]).astype(np.float32),
    )
    map_id = np.zeros(len(rows), np.int32) if map_of is None else np.asarray(map_of, np.int32)
    return SlamResult(
        camera=camera,
        mode=mode,
        frames=len(sequence),
        trajectory=Trajectory(frames, sequence.timestamps[frames], poses[frames]),
        keyframes=Keyframes(rows, sequence.timestamps[rows], poses[rows], map_id),
        points=MapPoints(xyz * scale, np.zeros((len(xyz), 3), np.uint8)),
        observations=observations,
        states=["lost" if i in lost else "ok" for i in range(len(sequence))],
        inliers=np.full(len(sequence), 100, np.int32),
    )


def _drawn(camera, wTc, depth, count, rng, max_depth):
    v = rng.integers(0, camera.height, count)
    u = rng.integers(0, camera.width, count)
    known = (depth[v, u] > 0) & (depth[v, u] < max_depth)
    v, u = v[known], u[known]
    return camera.backproject(np.stack([u, v], 1), depth[v, u]) @ wTc[:3, :3].T + wTc[:3, 3]


def _visible(camera, wTc, depth, xyz):
    """Rows, pixels and depths of the points that the camera sees, occluded ones left out."""
    local = (xyz - wTc[:3, 3]) @ wTc[:3, :3]
    ahead = np.flatnonzero(local[:, 2] > 0.1)
    uv = camera.project(local[ahead])
    inside = ((uv >= 0) & (uv <= [camera.width - 1, camera.height - 1])).all(1)
    ahead, uv = ahead[inside], uv[inside]
    z = local[ahead, 2]
    at = np.rint(uv).astype(int)
    free = np.abs(depth[at[:, 1], at[:, 0]] - z) < 0.03 * z
    return ahead[free], uv[free], z[free]
