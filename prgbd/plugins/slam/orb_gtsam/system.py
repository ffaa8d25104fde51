"""The SLAM system: frames in, trajectory and map out."""

from __future__ import annotations

import logging
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, ContractError
from prgbd.core.slam import GeometricSLAM, TrackingResult, TrackingState
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.plugins.slam.orb_gtsam.compilation import announce_compilation
from prgbd.plugins.slam.orb_gtsam.diagnostics import depth_ratio
from prgbd.plugins.slam.orb_gtsam.features import OrbExtractor
from prgbd.plugins.slam.orb_gtsam.frames import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.global_adjustment import adjust_map
from prgbd.plugins.slam.orb_gtsam.history import History
from prgbd.plugins.slam.orb_gtsam.initialisation import DepthStarter, Starter
from prgbd.plugins.slam.orb_gtsam.keyframe_decision import needs_keyframe
from prgbd.plugins.slam.orb_gtsam.lie import inverse
from prgbd.plugins.slam.orb_gtsam.local_map import Neighbourhoods
from prgbd.plugins.slam.orb_gtsam.local_mapping import LocalMapper
from prgbd.plugins.slam.orb_gtsam.mapping import Map
from prgbd.plugins.slam.orb_gtsam.recovery import recover
from prgbd.plugins.slam.orb_gtsam.rig import Rig
from prgbd.plugins.slam.orb_gtsam.settings import Settings
from prgbd.plugins.slam.orb_gtsam.timing import Stopwatch
from prgbd.plugins.slam.orb_gtsam.tracking import Tracker
from prgbd.plugins.slam.orb_gtsam.two_view_start import TwoViewStarter

log = logging.getLogger(__name__)


class OrbGtsamSLAM(GeometricSLAM):
    """ORB-SLAM2's ideas in Python: numba for what runs per feature, GTSAM for the whole map.

    The mapper runs in step with the tracker and everything is seeded, so equal input gives equal output.

    Args:
        **options: Any field of ``Settings``.

    Raises:
        ConfigError: If an option does not exist or has a value that cannot work.
    """

    modes: ClassVar[frozenset[str]] = frozenset({"mono", "rgbd"})

    def __init__(self, **options: Any) -> None:
        self.settings = Settings.from_options(options)
        self._ready = False

    def reset(
        self, camera: PinholeCamera, mode: str, *, baseline: float | None = None, fps: float = 30.0, seed: int = 0
    ) -> None:
        """Forget everything and get ready for a sequence; see ``GeometricSLAM.reset``.

        Raises:
            ConfigError: If mode, baseline, frame rate or camera cannot work.
        """
        if mode not in self.modes:
            raise ConfigError(f"orb_gtsam has no mode '{mode}'; set slam.mode to {' or '.join(sorted(self.modes))}.")
        if mode != "mono" and (baseline is None or not np.isfinite(baseline) or baseline <= 0):
            raise ConfigError(f"Mode '{mode}' needs a positive baseline in metres, got {baseline}; set slam.baseline.")
        if not np.isfinite(fps) or fps <= 0:
            raise ConfigError(f"The frame rate must be positive, got {fps}; set data.fps.")
        if any(camera.distortion):
            raise ConfigError(
                "orb_gtsam takes undistorted images, but the camera has distortion; undistort the frames and pass "
                "camera.undistorted()."
            )
        announce_compilation()
        settings = self.settings
        self._extractor = OrbExtractor(settings, camera.width, camera.height)
        near = 0.0 if mode == "mono" else float(baseline or 0.0)
        self._rig = Rig(
            camera,
            mode == "mono",
            near,
            near * settings.close_depth,
            settings.scales(),
            self._extractor.columns,
            near * settings.depth_trust if settings.depth_trust > 0 else np.inf,
        )
        cells = self._extractor.columns * self._extractor.rows
        self._map = Map(self._extractor.capacity, cells, self._rig.scales)
        self._near = Neighbourhoods(self._map, settings.covisible_weight)
        self._watch = Stopwatch()
        self._mapper = LocalMapper(settings, self._rig, self._map, self._near, self._watch)
        self._tracker = Tracker(settings, self._rig, self._map, self._near)
        self._history = History()
        least = settings.keypoints_to_start(camera.width, camera.height)
        self._starter: Starter = (
            TwoViewStarter(settings, self._rig, self._mapper, least, seed)
            if self._rig.mono
            else DepthStarter(self._mapper, least)
        )
        self._fps = fps
        self._started = False
        self._lost = 0
        self._last_keyframe = -1
        self._ratios: list[float] = []
        self._ready = True

    def track(self, frame: Frame) -> TrackingResult:
        """Track the next frame; see ``GeometricSLAM.track``.

        Raises:
            ContractError: If the frame does not fit the camera, lacks depth, or ``reset`` was not called.
        """
        self._require_ready()
        self._check(frame)
        with self._watch("features"):
            depth = None if self._rig.mono else frame.depth
            features = self._extractor.extract(frame.image, depth, self._rig.bf, self._rig.trusted_depth)
        self._ratios.append(float("nan"))
        current = TrackedFrame(frame.index, frame.timestamp, len(self._history.states), features)
        with self._watch("frame_total"):
            result = self._continue(current) if self._started else self._start(current)
        self._history.add(result.state, result.inliers)
        return result

    def _check(self, frame: Frame) -> None:
        camera = self._rig.camera
        shape = (camera.height, camera.width)
        if frame.image.shape != (*shape, 3) or frame.image.dtype != np.uint8:
            raise ContractError(
                f"Frame {frame.index} has an image {frame.image.shape} {frame.image.dtype}; the camera asks for "
                f"{(*shape, 3)} uint8 RGB."
            )
        if not self._rig.mono and (frame.depth is None or frame.depth.shape != shape):
            found = None if frame.depth is None else frame.depth.shape
            raise ContractError(f"Frame {frame.index} has depth {found}, but mode 'rgbd' needs {shape}; use 'mono'.")

    def _start(self, frame: TrackedFrame) -> TrackingResult:
        with self._watch("initialisation"):
            started = self._starter.add(frame)
        if started is None:
            return TrackingResult(TrackingState.NOT_INITIALIZED)
        tracker = self._tracker
        tracker.reference, tracker.velocity, tracker.last = started.reference, None, None
        frame.cTw, frame.points = started.cTw, started.points
        self._near.clear()
        tracker.refer(frame)
        for placed in started.earlier:
            self._place(placed.frame_index, placed.timestamp, placed.reference, placed.cTw)
            self._history.amend(placed.ordinal, TrackingState.OK, placed.inliers)
        self._place(frame.index, frame.timestamp, started.reference, frame.cTw)
        self._started, self._lost, self._last_keyframe = True, 0, frame.ordinal
        inliers = len(frame.matched())
        return TrackingResult(TrackingState.OK, inverse(frame.cTw), inliers, True)

    def _continue(self, frame: TrackedFrame) -> TrackingResult:
        tracker = self._tracker
        inliers = 0
        if self._lost == 0:
            with self._watch("tracking"):
                inliers = tracker.track(frame)
        if not inliers:
            with self._watch("recovery"):
                inliers = recover(tracker, frame)
        if not inliers:
            return self._lose(frame)
        if self._lost:
            log.info("Tracking recovered at frame %d after %d lost frames.", frame.index, self._lost)
        self._lost = 0
        self._ratios[-1] = depth_ratio(self._map, frame)
        keyframe = needs_keyframe(
            self._map,
            self._rig,
            self.settings,
            frame,
            inliers,
            tracker.reference,
            frame.ordinal - self._last_keyframe,
            self._fps,
        )
        if keyframe:
            # Outliers go along: bundle adjustment, not one frame, decides about them.
            k = self._mapper.add_keyframe(frame.index, frame.timestamp, frame.cTw, frame.features, frame.points)
            tracker.reference, self._last_keyframe = k, frame.ordinal
            frame.points = self._map.points_of(k).copy()
        tracker.remember(frame)
        frame_cTw = frame.cTw
        frame.drop_outliers()
        self._place(frame.index, frame.timestamp, tracker.reference, frame_cTw)
        if keyframe:
            with self._watch("mapping"):
                self._mapper.process(tracker.reference)
        return TrackingResult(TrackingState.OK, inverse(frame_cTw), inliers, keyframe)

    def _lose(self, frame: TrackedFrame) -> TrackingResult:
        """Count a lost frame, and start a new map if there is little to go back to."""
        self._lost += 1
        self._tracker.velocity = None
        small = len(self._map.alive()) <= self.settings.restart_keyframes
        if small or self._lost >= self.settings.restart_after:
            log.info("Tracking is lost at frame %d; starting a new map.", frame.index)
            self._map.current_map += 1
            self._starter.begin_at(self._tracker.last_pose())
            self._near.clear()
            self._started = False
        return TrackingResult(TrackingState.LOST)

    def _place(self, index: int, timestamp: float, reference: int, cTw: NDArray[np.float64]) -> None:
        cTref = cTw @ inverse(self._map.keyframes.cTw[reference])
        self._history.place(index, timestamp, reference, cTref, inverse(cTw))

    def finish(self) -> SlamResult:
        """End the sequence; see ``GeometricSLAM.finish``."""
        self._require_ready()
        stats: dict[str, Any] = {}
        if self.settings.full_ba:
            with self._watch("full_ba"):
                stats["full_ba"] = adjust_map(self._map, self._rig, self.settings, self._mapper)
        stats |= self._mapper.statistics()
        stats["stages_ms"] = self._watch.statistics()
        stats["maps"] = self._map.current_map + 1
        stats["lost_frames"] = sum(s == TrackingState.LOST.value for s in self._history.states)
        stats["depth_ratio"] = [None if np.isnan(r) else round(r, 4) for r in self._ratios]
        stats["baseline"] = self._rig.baseline
        result = self._history.result(self._map, self._rig, stats)
        self._ready = False
        return result

    def close(self) -> None:
        """Free the map."""
        for name in ("_map", "_mapper", "_tracker", "_history", "_starter", "_extractor", "_near"):
            self.__dict__.pop(name, None)
        self._ready = False

    def _require_ready(self) -> None:
        if not self._ready:
            raise ContractError("orb_gtsam was used before reset; call reset first.")
