"""The tracker's side of the system: from a frame with keypoints to its pose and the decision about a keyframe."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from prgbd.core.slam import TrackingResult, TrackingState
from prgbd.plugins.slam.orb_gtsam.diagnostics.frame_figures import DepthAgreement, depth_agreement
from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.keyframe_creation import KeyframeCreator
from prgbd.plugins.slam.orb_gtsam.tracking.depth_scale import DepthScaleFollower
from prgbd.plugins.slam.orb_gtsam.tracking.history import History
from prgbd.plugins.slam.orb_gtsam.tracking.initializer import Initializer
from prgbd.plugins.slam.orb_gtsam.tracking.keyframe_decision import needs_keyframe
from prgbd.plugins.slam.orb_gtsam.tracking.motion_model import MotionModel
from prgbd.plugins.slam.orb_gtsam.tracking.relocalisation import Relocaliser
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.tracking.tracker import Tracker

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Handover:
    """A keyframe for the mapper's side, and whether the local mapper works on it or only whoever comes after it."""

    keyframe: int
    local_mapping: bool = True


class FrontEnd:
    """Starts maps, tracks frames in them, and notices loss.

    Attributes:
        history: What became of every frame.
        depth_agreements: Per frame how its measured depth fits the map.

    Args:
        tracker: Finds poses in the map.
        relocaliser: Finds lost frames in any map.
        initializer: Makes the first keyframes of a map.
        creator: Makes keyframes of tracked frames.
        mapper_is_idle: Tells whether a keyframe would be mapped at once.
        watch: Gathers stage times.
        fps: Frame rate, for the keyframe decision.
        keyframe_outliers: Whether matches that a frame's pose refutes go along into its keyframe.
        depth_scale: Divides the depth of frames by its scale against the map; None takes it as it is.
    """

    def __init__(
        self,
        tracker: Tracker,
        relocaliser: Relocaliser,
        initializer: Initializer,
        creator: KeyframeCreator,
        mapper_is_idle: Callable[[], bool],
        watch: Stopwatch,
        fps: float,
        keyframe_outliers: bool = True,
        depth_scale: DepthScaleFollower | None = None,
    ) -> None:
        self.tracker, self.relocaliser, self.initializer = tracker, relocaliser, initializer
        self.creator, self.mapper_is_idle, self.watch = creator, mapper_is_idle, watch
        self.settings, self.camera, self.map, self.covisibility = (
            tracker.settings,
            tracker.camera,
            tracker.map,
            tracker.covisibility,
        )
        self.history = History()
        self.depth_agreements: list[DepthAgreement] = []
        self._fps = fps
        self._keyframe_outliers = keyframe_outliers
        self._depth_scale = depth_scale
        self._started = False
        # Lost frames in a row, those of them that showed something, and whether a new map is being tried.
        self._lost, self._unknown, self._restarting = 0, 0, False
        self._last_keyframe = -1
        self._motion_model = MotionModel()
        # The newest keyframe and which of its keypoints were outliers of the frame that it was made of.
        self._outliers: tuple[int, NDArray[np.bool_]] = (-1, np.zeros(0, np.bool_))
        self._handovers: list[Handover] = []

    def start_localisation(self) -> None:
        """Begin lost in a map of an earlier recording: frames look for their place in it."""
        self.tracker.reference = int(self.map.alive()[0])
        self.covisibility.clear()
        self._started, self._lost = True, 1

    def track(self, frame: TrackedFrame) -> tuple[TrackingResult, list[Handover]]:
        """Track a frame; the caller holds ``Map.lock``, and passes the keyframes on after giving it back."""
        self._handovers = []
        self.depth_agreements.append(DepthAgreement())
        if self._depth_scale is not None:
            self._depth_scale.correct(frame.features)
        result = self._continue(frame) if self._started else self._start(frame, TrackingState.NOT_INITIALIZED)
        self.history.add(result.state, result.inliers)
        return result, self._handovers

    def _start(self, frame: TrackedFrame, otherwise: TrackingState) -> TrackingResult:
        """Try to start a map; a frame that does not make one has the state ``otherwise``."""
        slam_map = self.map
        before, slam_map.current_map = slam_map.current_map, slam_map.next_map()
        with self.watch("initialisation"):
            started = self.initializer.add(frame)
        if started is None:
            slam_map.current_map = before
            return TrackingResult(otherwise)
        if self._restarting:
            log.info("Frame %d was not found in the map; it starts a new one.", frame.index)
        tracker = self.tracker
        tracker.reference, tracker.velocity, tracker.last = started.reference, None, None
        frame.cTw, frame.points = started.cTw, started.points
        self.covisibility.clear()
        tracker.refer(frame)
        for placed in started.earlier:
            self._place(placed.frame_index, placed.timestamp, placed.reference, placed.cTw)
            self.history.amend(placed.ordinal, TrackingState.OK, placed.inliers)
        self._place(frame.index, frame.timestamp, started.reference, frame.cTw)
        self._started, self._last_keyframe = True, frame.ordinal
        self._found()
        self._motion_model.clear()
        self._handovers = [Handover(k, local_mapping=False) for k in started.keyframes]
        self._note_depth_scale()
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
                inliers = self.relocaliser.find(frame)
        if not inliers:
            return self._lose(frame)
        if self._lost:
            log.info("Tracking recovered at frame %d after %d lost frames.", frame.index, self._lost)
            # The way from the last tracked frame is no motion between two frames.
            tracker.last = None
            self._motion_model.clear()
        self._found()
        self._motion_model.add(frame.ordinal, frame.cTw)
        self._compare_depth(frame)
        keyframe = self._wants_keyframe(frame, inliers)
        if keyframe:
            # If outliers go along, bundle adjustment, not one frame, decides about them.
            if not self._keyframe_outliers:
                frame.drop_outliers()
            k = self.creator.add(frame.index, frame.timestamp, frame.cTw, frame.features, frame.points)
            tracker.reference, self._last_keyframe = k, frame.ordinal
            self._outliers = (k, frame.outlier.copy())
            frame.points = self.map.points_of(k).copy()
            self._handovers = [Handover(k)]
            self._note_depth_scale()
        tracker.remember(frame)
        frame.drop_outliers()
        self._place(frame.index, frame.timestamp, tracker.reference, frame.cTw)
        return TrackingResult(TrackingState.OK, inverse(frame.cTw), inliers, keyframe)

    def _compare_depth(self, frame: TrackedFrame) -> None:
        """Note how the measured depth of a tracked frame fits the map, and let it follow the map's scale."""
        if self._depth_scale is None:
            self.depth_agreements[-1] = depth_agreement(self.map, self.camera, frame)
            return
        self._depth_scale.observe(frame)
        found = depth_agreement(self.map, self.camera, frame)
        self.depth_agreements[-1] = replace(found, ratio=found.ratio * float(np.exp(self._depth_scale.log_scale)))

    def _note_depth_scale(self) -> None:
        if self._depth_scale is not None:
            for handover in self._handovers:
                self._depth_scale.note(handover.keyframe)

    def _wants_keyframe(self, frame: TrackedFrame, inliers: int) -> bool:
        if self.settings.localise_only:
            return False
        newest, outliers = self._outliers
        unmapped = newest == self.tracker.reference and not self.mapper_is_idle()
        return needs_keyframe(
            self.map,
            self.camera,
            self.settings.keyframes,
            frame,
            inliers,
            self.tracker.reference,
            frame.ordinal - self._last_keyframe,
            self._fps,
            outliers if unmapped else None,
            0.0 if self._keyframe_outliers else self.settings.keyframes.held,
        )

    def _found(self) -> None:
        self._lost, self._unknown, self._restarting = 0, 0, False

    def _lose(self, frame: TrackedFrame) -> TrackingResult:
        """Count a lost frame, and try to start a new map once enough of them showed a place that is not known.

        Every further frame is looked for in the old maps first. A frame without anything to see changes nothing.
        """
        self._lost += 1
        self.tracker.velocity = None
        if self.settings.localise_only or not self.relocaliser.sees(frame):
            return TrackingResult(TrackingState.LOST)
        self._unknown += 1
        entered = self.tracker.last is not None  # a frame was tracked, since the start or since a map was loaded
        small = entered and len(self.map.alive()) <= self.settings.tracking.restart_keyframes
        begins = not self._restarting and (small or self._unknown >= self.settings.tracking.restart_after)
        if begins or (self._restarting and not self.camera.without_unit):
            self._restarting = True
            self.initializer.begin_at(self._expected(frame) if entered else np.eye(4))
        return self._start(frame, TrackingState.LOST) if self._restarting else TrackingResult(TrackingState.LOST)

    def _expected(self, frame: TrackedFrame) -> NDArray[np.float64]:
        """Where the camera would be had it gone on as before it was lost; without a unit gaps have no length."""
        gap = 0 if self.camera.without_unit or self._lost > self.settings.tracking.restart_extrapolate else self._lost
        return self._motion_model.after(gap) @ self.tracker.last_pose()

    def _place(self, index: int, timestamp: float, reference: int, cTw: NDArray[np.float64]) -> None:
        cTref = cTw @ inverse(self.map.keyframes.cTw[reference])
        scale = float(self.map.keyframes.scale[reference])
        self.history.place(index, timestamp, reference, cTref, inverse(cTw), scale)
