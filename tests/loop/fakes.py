"""A small world, a small network and a small SLAM system, real enough for the loop and done in milliseconds."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import cv2
import numpy as np
import torch
from torch import nn

from prgbd import (
    DepthEstimator,
    DepthPrediction,
    Frame,
    GeometricSLAM,
    Keyframes,
    MapPoints,
    Observations,
    PinholeCamera,
    Sequence,
    SlamResult,
    TrackingResult,
    TrackingState,
    Trajectory,
)
from prgbd.core.errors import DataError, WeightsError

STEP = 0.05
WALL = 4.0


class Wall(Sequence):
    """A camera that moves sideways along a textured wall, ``WALL`` metres away."""

    def __init__(
        self,
        sequence: str | None = None,
        root: str | None = None,
        frames: int = 12,
        seed: int = 0,
        sensor: bool = False,
    ) -> None:
        if root is not None and not os.path.isdir(root):
            raise DataError(f"There is no folder {root}; check data.root.")
        if sequence is not None and sequence not in ("00", "10"):
            raise DataError(f"There is no sequence '{sequence}'; there are '00' and '10'.")
        self.name, self.root = sequence or "wall", root
        self.camera = PinholeCamera(96, 64, 80.0, 80.0, 47.5, 31.5)
        self.timestamps = np.arange(frames) * 0.1
        self.sensor = sensor
        noise = np.random.default_rng(seed).integers(0, 255, (80, 300, 3), dtype=np.uint8)
        self._texture = cv2.GaussianBlur(noise, (0, 0), 1.5)

    @classmethod
    def available(cls, **options):
        return ["00", "10"] if options.get("root") else [None]

    def frame(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise IndexError(index)
        if index == 5 and self.root is not None and os.path.exists(os.path.join(self.root, f"{self.name}.broken")):
            raise DataError(f"Frame 5 of {self.name} is truncated; copy it anew.")
        shift = index * STEP / WALL * self.camera.fx
        moved = cv2.warpAffine(
            self._texture, np.array([[1.0, 0, -shift - 2], [0, 1, -4]]), (96, 64), flags=cv2.INTER_LINEAR
        )
        depth = self.depth(index) if self.sensor else None
        return Frame(index, float(self.timestamps[index]), moved, depth)

    @property
    def poses(self):
        wTc = np.tile(np.eye(4), (len(self), 1, 1))
        wTc[:, 0, 3] = np.arange(len(self)) * STEP
        wTc[:, 1, 3] = 0.01 * np.sin(np.arange(len(self)))
        return wTc

    def depth(self, index: int):
        return np.full((64, 96), WALL, np.float32)


class Tiny(DepthEstimator):
    """One depth for the whole image, 100 weights for the rest."""

    input_size = (32, 64)
    depth_range = (0.1, 100.0)

    def __init__(self, weights: str | None = None, start: float = 3.0) -> None:
        super().__init__()
        self.bias = nn.Parameter(torch.tensor(float(np.log(start))))
        self.conv = nn.Conv2d(3, 1, 5, padding=2)
        with torch.no_grad():
            self.conv.weight.mul_(0.1)
        if weights is not None:
            self.load_weights(weights)

    def forward(self, images):
        return DepthPrediction(((self.bias + 0.1 * torch.tanh(self.conv(images))).exp(),))


class Moving(nn.Module):
    """Believes in one small motion."""

    def __init__(self) -> None:
        super().__init__()
        self.step = nn.Parameter(torch.tensor(-STEP))

    def forward(self, first, second):
        T = torch.eye(4).repeat(len(first), 1, 1)
        return T + self.step * torch.eye(4)[0, :, None] * torch.eye(4)[3]


class TinyWithPose(Tiny):
    def __init__(self, weights: str | None = None) -> None:
        super().__init__()
        self.pose = Moving()
        if weights is not None:
            self.load_weights(weights)

    def pose_network(self):
        return self.pose


class NanDepth(Tiny):
    """Spoils the depth of the third frame that it sees."""

    bad = float("nan")

    def __init__(self, weights: str | None = None) -> None:
        super().__init__(weights)
        self.seen = 0

    def predict(self, image):
        depth = super().predict(image)
        self.seen += 1
        if self.seen == 3:
            depth[5, 5] = self.bad
        return depth


class Mortal(Tiny):
    """Kills the process, as a power cut would, in a training step: the ``die_at``-th that the process makes."""

    trained_in_process = 0

    def __init__(self, weights: str | None = None, die_at: int | None = None) -> None:
        super().__init__(weights)
        self.die_at = die_at
        self.dropout = nn.Dropout(0.1)

    def forward(self, images):
        if self.training:
            Mortal.trained_in_process += 1
            if Mortal.trained_in_process == self.die_at:
                os.kill(os.getpid(), signal.SIGKILL)
        prediction = super().forward(images)
        return DepthPrediction((prediction.depth * self.dropout(torch.ones(1)).clamp(0.9, 1.2),))


class WrongShape(Tiny):
    """Forgets the dimension of the channels."""

    def forward(self, images):
        return replace(super().forward(images), depths=(super().forward(images).depth[:, 0],))


class ZeroDepth(NanDepth):
    bad = 0.0


class Fussy(Tiny):
    def __init__(self, weights: str | None = None) -> None:
        raise WeightsError(f"{weights} holds the weights of another network than Fussy; choose others.")


class Sideways(GeometricSLAM):
    """Believes that the camera moves sideways at its known speed; takes its points from the depth of keyframes.

    ``die_at`` kills the process, as a power cut would, when so many frames were tracked in it.
    """

    modes = frozenset({"mono", "rgbd"})
    tracked_in_process = 0

    def __init__(self, every: int = 2, die_at: int | None = None, noise: float = 0.002) -> None:
        self.every, self.die_at, self.noise = every, die_at, noise

    def reset(self, camera, mode, *, baseline=None, fps=30.0, seed=0):
        self.camera, self.mode, self.seed = camera, mode, seed
        self.frames: list[Frame] = []
        self.poses: list[np.ndarray] = []
        self.random = np.random.default_rng(seed)

    def track(self, frame):
        Sideways.tracked_in_process += 1
        if self.die_at is not None and Sideways.tracked_in_process >= self.die_at:
            os.kill(os.getpid(), signal.SIGKILL)
        wTc = np.eye(4)
        wTc[:3, 3] = [len(self.frames) * STEP + self.random.normal(0, self.noise), self.random.normal(0, self.noise), 0]
        self.frames.append(frame)
        self.poses.append(wTc)
        return TrackingResult(TrackingState.OK, wTc, 100, len(self.frames) % self.every == 1)

    def finish(self):
        index = np.arange(len(self.frames))
        times = np.array([f.timestamp for f in self.frames])
        wTc = np.stack(self.poses)
        rows = index[:: self.every]
        u, v = np.meshgrid(np.arange(20, 76, 4.0), np.arange(8, 56, 4.0))
        uv = np.stack([u.ravel(), v.ravel()], 1)
        xyz = self.camera.backproject(uv, np.full(len(uv), WALL)) + wTc[rows[len(rows) // 2], :3, 3]
        keyframe, point, seen = [], [], []
        for row, frame in enumerate(rows):
            pixels = self.camera.project(xyz - wTc[frame, :3, 3])
            inside = (pixels > 1).all(1) & (pixels[:, 0] < 94) & (pixels[:, 1] < 62)
            keyframe.append(np.full(inside.sum(), row))
            point.append(np.flatnonzero(inside))
            seen.append(pixels[inside])
        uv_seen = np.concatenate(seen).astype(np.float32)
        observations = Observations(
            np.concatenate(keyframe).astype(np.int64),
            np.concatenate(point).astype(np.int64),
            uv_seen,
            np.full(len(uv_seen), WALL, np.float32),
        )
        trajectory = Trajectory(index.astype(np.int64), times, wTc)
        return SlamResult(
            camera=self.camera,
            mode=self.mode,
            frames=len(index),
            trajectory=trajectory,
            keyframes=Keyframes(rows.astype(np.int64), times[rows], wTc[rows], np.zeros(len(rows), np.int32)),
            points=MapPoints(xyz, np.full((len(xyz), 3), 128, np.uint8)),
            observations=observations,
            states=["ok"] * len(index),
            inliers=np.full(len(index), 100, np.int32),
            online=trajectory,
        )


def register() -> None:
    """Register all of it under ids that start with ``test/``."""
    from prgbd import register_data, register_depth, register_slam

    home = "tests.loop.fakes"
    register_data("test/wall", f"{home}:Wall", override=True)
    register_slam("test/sideways", f"{home}:Sideways", override=True)
    for name, cls in (
        ("tiny", "Tiny"),
        ("pose", "TinyWithPose"),
        ("nan", "NanDepth"),
        ("zero", "ZeroDepth"),
        ("flat", "WrongShape"),
        ("fussy", "Fussy"),
        ("mortal", "Mortal"),
    ):
        register_depth(f"test/{name}", f"{home}:{cls}", override=True)
