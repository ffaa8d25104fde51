"""Loop closing and the merging of maps."""

from __future__ import annotations

import logging
import time
from typing import Any

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.loop_closing.loop_correction import merge_both_sides, move_map, solve_loop
from prgbd.plugins.slam.orb_gtsam.loop_closing.loop_detection import LoopDetector
from prgbd.plugins.slam.orb_gtsam.loop_closing.loop_verification import Loop, LoopVerifier
from prgbd.plugins.slam.orb_gtsam.map.adjustment import MapAdjuster
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.keyframe_lookup import KeyframeLookup
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_correction import apply
from prgbd.plugins.slam.orb_gtsam.settings import Settings

log = logging.getLogger(__name__)


class LoopCloser:
    """Notices when a keyframe shows a known place, and makes the map agree: a loop, or another map to join.

    Args:
        settings: Thresholds.
        camera: The camera.
        slam_map: The map.
        covisibility: Covisible keyframes.
        adjuster: Bundle adjustment.
        database: Finds keyframes by appearance; whoever adds keyframes to the map adds them there.
        seed: Seed of RANSAC.

    Attributes:
        loops: What was closed, for the statistics.
    """

    def __init__(
        self,
        settings: Settings,
        camera: CameraModel,
        slam_map: Map,
        covisibility: CovisibilityGraph,
        adjuster: MapAdjuster,
        database: KeyframeLookup,
        seed: int = 0,
    ) -> None:
        self.settings, self.camera, self.map = settings, camera, slam_map
        self.covisibility, self.adjuster = covisibility, adjuster
        self.loops: list[dict[str, Any]] = []
        self._detector = LoopDetector(slam_map, covisibility, database, settings.loop_closing.min_interval)
        self._verifier = LoopVerifier(slam_map, camera, covisibility, settings.loop_closing.scale, seed)
        self._closed: list[tuple[int, int]] = []
        self._last = -settings.loop_closing.min_interval

    def process(self, k: int) -> bool:
        """Look whether keyframe ``k``, already mapped, closes a loop; close it. Returns whether the map changed."""
        kf = self.map.keyframes
        if kf.bad[k] or k - self._last < self.settings.loop_closing.min_interval:
            return False
        start = time.perf_counter()
        loop = self._find(k)
        if loop is None:
            return False
        other = int(kf.map_id[loop.candidate])
        merge = other != kf.map_id[k]
        note = {
            "keyframe": k,
            "frame": int(kf.frame_index[k]),
            "loop_frame": int(kf.frame_index[loop.candidate]),
            "inliers": len(loop.rows),
            "scale": loop.scale,
            "kind": "merge" if merge else "loop",
        }
        if not self._close(loop, merge):
            log.info("Refused a loop of frame %d with frame %d.", note["frame"], note["loop_frame"])
            return False
        self._last = k
        self._detector.forget()
        note["ms"] = 1000.0 * (time.perf_counter() - start)
        self.loops.append(note)
        log.info(
            "Frame %d: %s with frame %d (scale %.3f).", note["frame"], note["kind"], note["loop_frame"], loop.scale
        )
        return True

    def _find(self, k: int) -> Loop | None:
        with self.map.lock:
            candidates = self._detector.propose(k)
        for candidate in candidates:
            with self.map.lock:
                loop = self._verifier.verify(k, candidate)
            if loop is not None:
                return loop
        return None

    def _close(self, loop: Loop, merge: bool) -> bool:
        """Correct the map; returns whether the rest of the map admits it."""
        slam_map, kf = self.map, self.map.keyframes
        # Only the mapper's side moves keyframes, so the graph may be solved while the tracker goes on.
        correction = move_map(slam_map, loop) if merge else solve_loop(self.covisibility, loop, self._closed)
        if correction is None:
            return False
        with slam_map.lock:
            apply(slam_map, loop.k, correction)
            if merge:
                slam_map.join(int(kf.map_id[loop.k]), int(kf.map_id[loop.candidate]))
            merge_both_sides(self.camera, self.covisibility, loop)
        self._closed.append((loop.k, loop.candidate))
        if self.settings.optimisation.local_ba:
            self.adjuster.adjust_locally(loop.k)
        if self.settings.loop_closing.bundle_adjustment:
            self.adjuster.adjust_globally(only=int(kf.map_id[loop.k]))
        with slam_map.lock:
            self.covisibility.clear()
        return True
