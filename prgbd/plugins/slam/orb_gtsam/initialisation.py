"""The first keyframes of a map: from one frame with depth, or from two frames without."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.bundle_adjustment import local_bundle_adjustment
from prgbd.plugins.slam.orb_gtsam.frames import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.lie import inverse
from prgbd.plugins.slam.orb_gtsam.local_mapping import LocalMapper
from prgbd.plugins.slam.orb_gtsam.matching import match_by_projection
from prgbd.plugins.slam.orb_gtsam.rig import Rig
from prgbd.plugins.slam.orb_gtsam.settings import Settings
from prgbd.plugins.slam.orb_gtsam.two_view import TwoView, initialise_two_view

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Placed:
    """An earlier frame that the start gave a pose to."""

    frame_index: int
    timestamp: float
    reference: int
    cTw: FloatArray


@dataclass(frozen=True)
class Started:
    """A new map.

    Attributes:
        reference: Keyframe made of the present frame.
        cTw: (4, 4) its pose.
        points: (N,) int64 point of every keypoint.
        earlier: Earlier frames that got a pose as well.
    """

    reference: int
    cTw: FloatArray
    points: IntArray
    earlier: list[Placed] = field(default_factory=list)


class Starter(ABC):
    """Takes frames until a map can be started."""

    def __init__(self, mapper: LocalMapper, least_keypoints: int) -> None:
        self.mapper = mapper
        self.least_keypoints = least_keypoints
        self.origin: FloatArray = np.eye(4)

    def begin_at(self, cTw: FloatArray) -> None:
        """Start the next map at this pose."""
        self.origin = cTw

    @abstractmethod
    def add(self, frame: TrackedFrame) -> Started | None:
        """Take a frame; return the new map once there is one."""


class DepthStarter(Starter):
    """Starts from one frame with enough keypoints and depth (Tracking::StereoInitialization)."""

    # Fewer points could not be tracked from the next frame.
    _LEAST_POINTS = 50

    def add(self, frame: TrackedFrame) -> Started | None:
        """See ``Starter.add``."""
        features = frame.features
        if len(features) <= self.least_keypoints or np.count_nonzero(features.depth > 0) < self._LEAST_POINTS:
            return None
        k = self.mapper.add_keyframe(frame.index, frame.timestamp, self.origin, features, frame.points)
        points = self.mapper.lift_all(k)
        return Started(k, self.origin, points)


class TwoViewStarter(Starter):
    """Starts from two frames without depth (Tracking::MonocularInitialization); the unit is the median depth.

    Args:
        settings: Thresholds.
        rig: The camera.
        mapper: Gets the two keyframes.
        least_keypoints: Keypoints that both frames must have.
        seed: Seed of the robust estimation.
    """

    # Coarser levels place their keypoints too badly for a first reconstruction.
    _COARSEST = 2
    _WINDOW = 100.0
    _LEAST_POINTS = 50

    def __init__(self, settings: Settings, rig: Rig, mapper: LocalMapper, least_keypoints: int, seed: int) -> None:
        super().__init__(mapper, least_keypoints)
        self.settings, self.rig, self.seed = settings, rig, seed
        self._least_matches = min(settings.init_matches, least_keypoints)
        self._first: TrackedFrame | None = None
        self._rows: IntArray = np.zeros(0, np.int64)
        self._around: FloatArray = np.zeros((0, 3))

    def begin_at(self, cTw: FloatArray) -> None:
        """See ``Starter.begin_at``."""
        super().begin_at(cTw)
        self._first = None

    def add(self, frame: TrackedFrame) -> Started | None:
        """See ``Starter.add``."""
        if len(frame.features) < self.least_keypoints:
            self._first = None
            return None
        if self._first is None:
            self._take_first(frame)
            return None
        found = self._match(frame)
        good = found >= 0
        if np.count_nonzero(good) < self._least_matches:
            self._take_first(frame)
            return None
        # The next search starts where the keypoints are now.
        self._around[good, :2] = frame.features.uv[found[good]]
        rows, partners = self._rows[good], found[good]
        first = self._first
        views = initialise_two_view(
            first.features.uv[rows].astype(np.float64),
            frame.features.uv[partners].astype(np.float64),
            self.rig.camera.K,
            self.seed,
        )
        if views is None or np.count_nonzero(views.good) < self._LEAST_POINTS:
            return None
        return self._build(first, frame, rows[views.good], partners[views.good], views)

    def _take_first(self, frame: TrackedFrame) -> None:
        self._first = frame
        self._rows = np.flatnonzero(frame.features.octave <= self._COARSEST)
        self._around = np.full((len(self._rows), 3), -1.0)
        self._around[:, :2] = frame.features.uv[self._rows]

    def _match(self, frame: TrackedFrame) -> IntArray:
        assert self._first is not None
        first = self._first.features
        octave = first.octave[self._rows].astype(np.int64)
        return match_by_projection(
            self._around,
            np.full(len(self._rows), self._WINDOW * min(1.0, self.rig.camera.width / 640)),
            (octave, octave),
            first.descriptor[self._rows],
            frame.features,
            self.rig.columns,
            limit=self.settings.distance_low,
            ratio=self.settings.ratio_motion,
            angles=first.angle[self._rows],
        )

    def _build(
        self, first: TrackedFrame, second: TrackedFrame, rows: IntArray, partners: IntArray, views: TwoView
    ) -> Started | None:
        xyz, c2Tc1 = self._adjust(first, second, rows, partners, views)
        depth = float(np.median(xyz[:, 2]))
        if depth <= 0 or np.count_nonzero(xyz[:, 2] > 0) < self._LEAST_POINTS:
            return None
        xyz, c2Tc1 = xyz / depth, c2Tc1.copy()
        c2Tc1[:3, 3] /= depth
        front = np.flatnonzero((xyz[:, 2] > 0) & ((xyz @ c2Tc1[:3, :3].T + c2Tc1[:3, 3])[:, 2] > 0))
        world, wTc1 = self.mapper.world, inverse(self.origin)
        k1 = self.mapper.add_keyframe(first.index, first.timestamp, self.origin, first.features, first.points)
        cTw = c2Tc1 @ self.origin
        k2 = self.mapper.add_keyframe(second.index, second.timestamp, cTw, second.features, second.points)
        ids = world.add_points(k1, rows[front], xyz[front] @ wTc1[:3, :3].T + wTc1[:3, 3])
        world.observe(k2, partners[front], ids)
        world.points.reference[ids] = world.points.created[ids] = k2
        world.refresh(ids)
        self._first = None
        earlier = [Placed(first.index, first.timestamp, k1, self.origin)]
        return Started(k2, cTw, world.points_of(k2).copy(), earlier)

    def _adjust(
        self, first: TrackedFrame, second: TrackedFrame, rows: IntArray, partners: IntArray, views: TwoView
    ) -> tuple[FloatArray, FloatArray]:
        """Bundle adjustment of the two views, the first one fixed; return points and motion."""
        n, variance = len(rows), self.rig.inverse_variance
        result = local_bundle_adjustment(
            np.stack([np.eye(4), views.c2Tc1]),
            np.array([True, False]),
            views.xyz[views.good],
            np.repeat(np.arange(2), n),
            np.tile(np.arange(n), 2),
            np.concatenate([self.rig.measured(first.features, rows), self.rig.measured(second.features, partners)]),
            np.concatenate([variance[first.features.octave[rows]], variance[second.features.octave[partners]]]),
            *self.rig.intrinsics,
            iterations=(10, 10),
        )
        return result.xyz, result.cTw[1]


def starter(settings: Settings, rig: Rig, mapper: LocalMapper, least_keypoints: int, seed: int) -> Starter:
    """Return the starter of the rig's mode."""
    if rig.mono:
        return TwoViewStarter(settings, rig, mapper, min(least_keypoints, settings.init_matches), seed)
    return DepthStarter(mapper, least_keypoints)
