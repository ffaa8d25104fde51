"""The tracker's side of the system: from a frame with keypoints to its pose and the decision about a keyframe."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.core.slam import TrackingResult, TrackingState
from prgbd.plugins.slam.orb_gtsam.backend import MappingBackend
from prgbd.plugins.slam.orb_gtsam.diagnostics import depth_ratio
from prgbd.plugins.slam.orb_gtsam.frames import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.history import History
from prgbd.plugins.slam.orb_gtsam.initialisation import Starter
from prgbd.plugins.slam.orb_gtsam.keyframe_decision import needs_keyframe
from prgbd.plugins.slam.orb_gtsam.lie import inverse
from prgbd.plugins.slam.orb_gtsam.recovery import recover
from prgbd.plugins.slam.orb_gtsam.timing import Stopwatch
from prgbd.plugins.slam.orb_gtsam.tracking import Tracker

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Handover:
    """A keyframe for the mapper's side, see ``MappingBackend.submit``."""

    keyframe: int
    local_mapping: bool = True


class FrontEnd:
    """Starts maps, tracks frames in them, and notices loss.

    Attributes:
        history: What became of every frame.
        depth_ratios: Per frame the ratio of measured depth to that in the map, NaN where unknown.

    Args:
        tracker: Finds poses in the map.
        starter: Makes the first keyframes of a map.
        backend: The mapper's side.
        watch: Gathers stage times.
        fps: Frame rate, for the keyframe decision.
    """

    def __init__(
        self, tracker: Tracker, starter: Starter, backend: MappingBackend, watch: Stopwatch, fps: float
    ) -> None:
        self.tracker, self.starter, self.backend, self.watch = tracker, starter, backend, watch
        self.settings, self.rig, self.world, self.near = tracker.settings, tracker.rig, tracker.world, tracker.near
        self.history = History()
        self.depth_ratios: list[float] = []
        self._fps = fps
        self._started = False
        self._lost = 0
        self._last_keyframe = -1
        self._handovers: list[Handover] = []

    def enter(self) -> None:
        """Begin lost in a map of an earlier recording: frames look for their place in it."""
        self.tracker.reference = int(self.world.alive()[0])
        self.near.clear()
        self._started, self._lost = True, 1

    def take(self, frame: TrackedFrame) -> tuple[TrackingResult, list[Handover]]:
        """Track a frame; the caller holds ``Map.lock``, and passes the keyframes on after giving it back."""
        self._handovers = []
        self.depth_ratios.append(float("nan"))
        result = self._continue(frame) if self._started else self._start(frame)
        self.history.add(result.state, result.inliers)
        return result, self._handovers

    def _start(self, frame: TrackedFrame) -> TrackingResult:
        with self.watch("initialisation"):
            started = self.starter.add(frame)
        if started is None:
            return TrackingResult(TrackingState.NOT_INITIALIZED)
        tracker = self.tracker
        tracker.reference, tracker.velocity, tracker.last = started.reference, None, None
        frame.cTw, frame.points = started.cTw, started.points
        self.near.clear()
        tracker.refer(frame)
        for placed in started.earlier:
            self._place(placed.frame_index, placed.timestamp, placed.reference, placed.cTw)
            self.history.amend(placed.ordinal, TrackingState.OK, placed.inliers)
        self._place(frame.index, frame.timestamp, started.reference, frame.cTw)
        self._started, self._lost, self._last_keyframe = True, 0, frame.ordinal
        self._handovers = [Handover(k, local_mapping=False) for k in started.keyframes]
        inliers = len(frame.matched())
        return TrackingResult(TrackingState.OK, inverse(frame.cTw), inliers, True)

    def _continue(self, frame: TrackedFrame) -> TrackingResult:
        tracker = self.tracker
        inliers = 0
        if self._lost == 0:
            with self.watch("tracking"):
                inliers = tracker.track(frame)
        if not inliers:
            with self.watch("recovery"):
                inliers = recover(tracker, frame)
        if not inliers:
            return self._lose(frame)
        if self._lost:
            log.info("Tracking recovered at frame %d after %d lost frames.", frame.index, self._lost)
        self._lost = 0
        self.depth_ratios[-1] = depth_ratio(self.world, frame)
        keyframe = self._wants_keyframe(frame, inliers)
        if keyframe:
            # Outliers go along: bundle adjustment, not one frame, decides about them.
            k = self.backend.mapper.add_keyframe(frame.index, frame.timestamp, frame.cTw, frame.features, frame.points)
            tracker.reference, self._last_keyframe = k, frame.ordinal
            frame.points = self.world.points_of(k).copy()
            self._handovers = [Handover(k)]
        tracker.remember(frame)
        frame.drop_outliers()
        self._place(frame.index, frame.timestamp, tracker.reference, frame.cTw)
        return TrackingResult(TrackingState.OK, inverse(frame.cTw), inliers, keyframe)

    def _wants_keyframe(self, frame: TrackedFrame, inliers: int) -> bool:
        return not self.settings.localise_only and needs_keyframe(
            self.world,
            self.rig,
            self.settings,
            frame,
            inliers,
            self.tracker.reference,
            frame.ordinal - self._last_keyframe,
            self._fps,
        )

    def _lose(self, frame: TrackedFrame) -> TrackingResult:
        """Count a lost frame, and start a new map if there is little to go back to."""
        self._lost += 1
        self.tracker.velocity = None
        if self.settings.localise_only:
            return TrackingResult(TrackingState.LOST)
        entered = self.tracker.last is not None  # a frame was tracked, since the start or since a map was loaded
        small = entered and len(self.world.alive()) <= self.settings.restart_keyframes
        if small or self._lost >= self.settings.restart_after:
            log.info("Tracking is lost at frame %d; starting a new map.", frame.index)
            self.world.current_map += 1
            self.starter.begin_at(self.tracker.last_pose() if entered else np.eye(4))
            self.near.clear()
            self._started = False
        return TrackingResult(TrackingState.LOST)

    def _place(self, index: int, timestamp: float, reference: int, cTw: NDArray[np.float64]) -> None:
        cTref = cTw @ inverse(self.world.keyframes.cTw[reference])
        scale = float(self.world.keyframes.scale[reference])
        self.history.place(index, timestamp, reference, cTref, inverse(cTw), scale)
