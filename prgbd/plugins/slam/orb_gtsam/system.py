"""The SLAM system: frames in, trajectory and map out."""

from __future__ import annotations

import logging
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from prgbd.core.bare_starts import without_bare_starts
from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import ConfigError, ContractError
from prgbd.core.slam import GeometricSLAM, SlamView, TrackingResult, TrackingState
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.camera.depth_noise import depth_noise
from prgbd.plugins.slam.orb_gtsam.camera.virtual_baseline import MEDIAN_BASELINE, RunningBaseline, set_baseline
from prgbd.plugins.slam.orb_gtsam.diagnostics.compilation_notice import announce_compilation
from prgbd.plugins.slam.orb_gtsam.diagnostics.depth_error import depth_error
from prgbd.plugins.slam.orb_gtsam.diagnostics.frame_figures import depth_figures, map_sizes, view_of
from prgbd.plugins.slam.orb_gtsam.diagnostics.map_health import doubts_about
from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.features.frame_reader import FrameReader
from prgbd.plugins.slam.orb_gtsam.features.recent_images import RecentImages
from prgbd.plugins.slam.orb_gtsam.loop_closing.keyframe_database import KeyframeDatabase
from prgbd.plugins.slam.orb_gtsam.loop_closing.loop_closer import LoopCloser
from prgbd.plugins.slam.orb_gtsam.map.adjustment import MapAdjuster
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.keyframe_creation import KeyframeCreator
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_correction import follow_baseline
from prgbd.plugins.slam.orb_gtsam.map.map_file import load_map, loaded_keyframes, save_map
from prgbd.plugins.slam.orb_gtsam.mapping.backend import MappingBackend
from prgbd.plugins.slam.orb_gtsam.mapping.local_mapper import LocalMapper
from prgbd.plugins.slam.orb_gtsam.mapping.observation_alignment import ObservationAligner
from prgbd.plugins.slam.orb_gtsam.mapping.scale_drift import correct_scale, give_depth_back
from prgbd.plugins.slam.orb_gtsam.mapping.self_calibration import self_calibrate
from prgbd.plugins.slam.orb_gtsam.mapping.threaded_backend import ThreadedBackend
from prgbd.plugins.slam.orb_gtsam.optimisation.make_solver import make_solver
from prgbd.plugins.slam.orb_gtsam.settings import Settings
from prgbd.plugins.slam.orb_gtsam.tracking.depth_affine import AffineDepthFollower
from prgbd.plugins.slam.orb_gtsam.tracking.depth_scale import DepthScaleFollower
from prgbd.plugins.slam.orb_gtsam.tracking.front_end import FrontEnd
from prgbd.plugins.slam.orb_gtsam.tracking.initializer import DepthInitializer, Initializer, keypoints_to_start
from prgbd.plugins.slam.orb_gtsam.tracking.relocalisation import Relocaliser
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.tracking.tracker import Tracker
from prgbd.plugins.slam.orb_gtsam.tracking.two_view_initializer import TwoViewInitializer

log = logging.getLogger(__name__)

# Modes whose last adjustment asks whether the focal length fits; a sensor's depth says where it does not.
_SELF_CALIBRATED = ("mono", "pseudo_rgbd")
# Keyframes whose images are kept, to align what new ones see.
_RECENT = 30


class OrbGtsamSLAM(GeometricSLAM):
    """ORB-SLAM2's ideas in Python: numba for what runs per feature, GTSAM for the whole map.

    Images of a distorted camera are taken as they are: keypoints are undistorted, and the result's camera has no
    distortion. Mode ``pseudo_rgbd`` without a baseline adapts it to the largest depth of the frames so far. The mapper
    runs in step with the tracker and everything is seeded, so equal input gives equal output; ``realtime`` runs it in a
    thread.

    Args:
        **options: Any field of ``Settings``.

    Raises:
        ConfigError: If an option does not exist or has a value that cannot work.
    """

    modes: ClassVar[frozenset[str]] = frozenset({"mono", "rgbd", "pseudo_rgbd", "stereo"})

    def __init__(self, **options: Any) -> None:
        self.settings = Settings.from_options(options)
        self._depth_kind = DepthKind.SCALE
        self._ready = False

    def expect_depth(self, kind: DepthKind) -> None:
        """See ``GeometricSLAM.expect_depth``; it holds for every sequence to come."""
        self._depth_kind = kind

    def reset(
        self, camera: PinholeCamera, mode: str, *, baseline: float | None = None, fps: float = 30.0, seed: int = 0
    ) -> None:
        """Forget everything and get ready for a sequence; see ``GeometricSLAM.reset``.

        Raises:
            ConfigError: If mode, baseline, frame rate or camera cannot work.
        """
        if mode not in self.modes:
            raise ConfigError(f"orb_gtsam has no mode '{mode}'; set slam.mode to {' or '.join(sorted(self.modes))}.")
        affine = self._is_affine(mode)
        if affine:
            baseline = MEDIAN_BASELINE
        running = mode == "pseudo_rgbd" and baseline is None
        if mode != "mono" and not running and (baseline is None or not np.isfinite(baseline) or baseline <= 0):
            raise ConfigError(f"Mode '{mode}' needs a positive baseline in metres, got {baseline}; set slam.baseline.")
        if not np.isfinite(fps) or fps <= 0:
            raise ConfigError(f"The frame rate must be positive, got {fps}; set data.fps.")
        self.close()
        announce_compilation()
        options = self.settings.optimisation
        self._given, self._mode = camera, mode
        self._reader = FrameReader(self.settings.features, camera, mode)
        self._running = RunningBaseline() if running else None
        self._camera = self._camera_model(camera, mode, float(baseline or 0.0))
        extractor = self._reader.left
        self._map = Map(extractor.capacity, extractor.columns * extractor.rows, self._camera.scales)
        self._covisibility = CovisibilityGraph(self._map)
        self._solver = make_solver(options.solver)
        self._adjuster = MapAdjuster(options, self._camera, self._map, self._covisibility, self._solver)
        self._watch = Stopwatch()
        self._database = KeyframeDatabase(seed=seed)
        self._loops = LoopCloser(
            self.settings, self._camera, self._map, self._covisibility, self._adjuster, self._database, seed
        )
        self._backend = self._make_backend()
        self._front_end = self._make_front_end(fps, seed)
        self._ready = True

    def _camera_model(self, camera: PinholeCamera, mode: str, baseline: float) -> CameraModel:
        settings, extractor = self.settings, self._reader.left
        model = CameraModel(
            camera.undistorted(),
            mode == "mono",
            0.0,
            0.0,
            extractor.scales,
            extractor.columns,
            stereo=mode == "stereo",
            noise=depth_noise(settings.depth, mode, extractor.capacity),
            affine=self._is_affine(mode),
        )
        if mode != "mono":
            set_baseline(model, settings.depth, baseline)
        return model

    def _make_backend(self) -> MappingBackend:
        """Make the mapper's side; after the mapper a keyframe passes the loop closer, then enters the database."""
        settings = self.settings
        self._images = RecentImages(self._reader.left.sizes, _RECENT)
        aligner = (
            ObservationAligner(self._map, self._camera, self._images, self._reader.lens)
            if settings.features.aligns(self._mode)
            else None
        )
        mapper = LocalMapper(
            settings, self._camera, self._map, self._covisibility, self._adjuster, self._watch, aligner
        )
        mapper.after_culling.append(self._database.remove)
        backend = (
            ThreadedBackend(mapper, self._watch, settings.mapping.queue)
            if settings.realtime
            else MappingBackend(mapper, self._watch)
        )
        if settings.loop_closing.enabled:
            backend.after_keyframe.append(self._close_loop)
        backend.after_keyframe.append(self._index)
        return backend

    def _close_loop(self, k: int) -> None:
        with self._watch("loop_closing"):
            self._loops.process(k)

    def _index(self, k: int) -> None:
        with self._watch("keyframe_database"):
            self._database.add(k, self._map.features(k).descriptor)

    def _make_front_end(self, fps: float, seed: int) -> FrontEnd:
        settings, camera = self.settings, self._camera
        creator = KeyframeCreator(camera, self._map, self._covisibility)
        least = keypoints_to_start(self._reader.left.capacity, camera.pinhole.width, camera.pinhole.height)
        initializer: Initializer = (
            TwoViewInitializer(settings, camera, creator, self._solver, least, seed)
            if camera.without_unit
            else DepthInitializer(creator, least)
        )
        tracker = Tracker(settings, camera, self._map, self._covisibility)
        return FrontEnd(
            tracker,
            Relocaliser(tracker, self._database),
            initializer,
            creator,
            self._backend.is_idle,
            self._watch,
            fps,
            settings.keyframes.take_outliers(self._mode),
            self._make_depth_follower(),
        )

    def _is_affine(self, mode: str) -> bool:
        """Say whether scale and shift of inverse depth are to be found."""
        return self._depth_kind == DepthKind.AFFINE_DISPARITY and self.settings.depth.follows(mode)

    def _make_depth_follower(self) -> DepthScaleFollower | None:
        if not self.settings.depth.follows(self._mode):
            return None
        return (AffineDepthFollower if self._camera.affine else DepthScaleFollower)(self._map, self._camera)

    def track(self, frame: Frame) -> TrackingResult:
        """Track the next frame; see ``GeometricSLAM.track``.

        Raises:
            ContractError: If the frame does not fit the camera, lacks depth, or ``reset`` was not called.
        """
        self._require_ready()
        self._reader.check(frame)
        if self.settings.localise_only and not self._map.keyframes.count:
            raise ConfigError("slam.localise_only=true needs a map to localise in; give slam.load_map=FILE.")
        if self._running is not None and frame.depth is not None and self._running.see(frame.depth):
            self._rebase(self._running.baseline)
        with self._watch("features"):
            features = self._reader.read(frame, self._camera)
        self._backend.check()
        with self._watch("frame_total"):
            with self._map.lock:
                current = TrackedFrame(frame.index, frame.timestamp, len(self._front_end.history.states), features)
                result, handovers = self._front_end.track(current)
                if handovers:  # of two keyframes that start a map the first one saw an earlier frame
                    self._images.add(handovers[-1].keyframe, self._reader.left.pyramid)
                sizes = map_sizes(self._map)
            for handover in handovers:
                self._backend.insert_keyframe(handover.keyframe, local_mapping=handover.local_mapping)
        return replace(result, info=sizes)

    def _rebase(self, baseline: float) -> None:
        """Take another virtual baseline; what was measured before follows."""
        self._backend.drain()
        with self._map.lock:
            set_baseline(self._camera, self.settings.depth, baseline)
            follow_baseline(self._map, self._camera)

    def view(self) -> SlamView | None:
        """See ``GeometricSLAM.view``."""
        if not self._ready:
            return None
        last, frames = self._front_end.tracker.last, len(self._front_end.history.states)
        with self._map.lock:
            return view_of(self._map, last.frame if last is not None and last.frame.ordinal == frames - 1 else None)

    def save_map(self, path: Path | str) -> None:
        """See ``GeometricSLAM.save_map``."""
        if "_map" not in self.__dict__:
            raise ContractError("orb_gtsam has no map to save; call reset and track first.")
        if self._ready:
            self._backend.drain()
        with self._map.lock:
            save_map(self._map, self._camera, self._given, self.settings, path)

    def load_map(self, path: Path | str) -> None:
        """See ``GeometricSLAM.load_map``; all keypoints, points and observations come back.

        Raises:
            DataError: If the file is missing, truncated, or of another version.
            ConfigError: If the map does not fit the camera, the mode or the settings, or has no keyframes.
        """
        self._require_ready()
        if self._front_end.history.states:
            raise ContractError("A map was loaded after the first frame; call load_map between reset and track.")
        with self._map.lock:
            load_map(self._map, self._camera, path)
            if len(self._map.alive()) == 0:
                raise ConfigError(f"The map {path} has no keyframes; leave slam.load_map out.")
            for map_id in self._map.map_ids():
                for k in self._map.alive(map_id).tolist():
                    self._database.add(k, self._map.features(k).descriptor)
            self._front_end.start_localisation()

    def finish(self) -> SlamResult:
        """End the sequence; see ``GeometricSLAM.finish``."""
        self._require_ready()
        self._backend.drain()
        self._backend.close()
        stats: dict[str, Any] = {"baseline": self._camera.baseline} | self._adjust() | self._statistics()
        found = self._front_end.history.result(self._map, self._camera, stats)
        result = without_bare_starts(found)
        stats["bare_starts"] = len(found.keyframes) - len(result.keyframes)
        stats["lost_frames"] = sum(s == TrackingState.LOST.value for s in result.states)
        stats["doubts"] = doubts_about(result, stats.get("full_ba", {}).get("maps", []))
        if stats["doubts"]:
            log.warning("The trajectory is doubtful: %s.", "; ".join(stats["doubts"]))
        self._ready = False
        return result

    def _adjust(self) -> dict[str, Any]:
        """Adjust the whole map, as far as that is wanted; return what was done."""
        done: dict[str, Any] = {}
        options = self.settings.optimisation
        if options.full_ba and not self.settings.localise_only:
            done |= self._adjust_globally()
        if self.settings.depth.follows(self._mode):
            with self._watch("scale_drift"), self._map.lock:
                if not self.settings.localise_only:
                    done["scale_drift"] = correct_scale(self._map, self._camera)
                give_depth_back(self._map, self._camera)
        return done

    def _adjust_globally(self) -> dict[str, Any]:
        done: dict[str, Any] = {}
        options = self.settings.optimisation
        sigma = options.focal_length_sigma
        if self._mode in _SELF_CALIBRATED and sigma > 0:
            with self._watch("self_calibration"):
                done["focal_length"] = self_calibrate(self._map, self._camera, self._solver, sigma)
        with self._watch("full_ba"):
            done["full_ba"] = self._adjuster.adjust_globally()
        return done

    def _statistics(self) -> dict[str, Any]:
        stats: dict[str, Any] = asdict(self._map.counts) | self._backend.statistics()
        stats["loops"] = self._loops.loops
        stats["starts"] = self._front_end.initializer.starts
        stats["stages_ms"] = self._watch.statistics()
        stats["maps"] = len(self._map.map_ids())
        stats["loaded_keyframes"] = loaded_keyframes(self._map)
        stats |= depth_figures(self._front_end.depth_agreements)
        if not self._camera.mono:
            error = depth_error(self._map, self._camera)
            stats["depth_error"] = None if error is None else asdict(error)
        return stats

    def close(self) -> None:
        """Stop the mapper and free the map."""
        if "_backend" in self.__dict__:
            self._backend.close()
        for name in ("_map", "_covisibility", "_adjuster", "_loops", "_backend", "_front_end", "_reader"):
            self.__dict__.pop(name, None)
        self._ready = False

    def _require_ready(self) -> None:
        if not self._ready:
            raise ContractError("orb_gtsam was used before reset; call reset first.")
