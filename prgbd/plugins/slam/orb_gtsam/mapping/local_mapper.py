"""The local mapper: what happens to the map after each new keyframe."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.map.adjustment import MapAdjuster
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.culling import cull_new_points, is_redundant
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.merging import merge_duplicates
from prgbd.plugins.slam.orb_gtsam.mapping.observation_alignment import ObservationAligner
from prgbd.plugins.slam.orb_gtsam.mapping.triangulation import create_points
from prgbd.plugins.slam.orb_gtsam.settings import Settings

IntArray = NDArray[np.int64]

# ORB-SLAM2 (LocalMapping::SearchInNeighbors): neighbours of a neighbour that take part in the merging of duplicates.
_SECOND_NEIGHBOURS = 5


class LocalMapper:
    """Keeps the map clean and consistent around new keyframes.

    Args:
        settings: Thresholds.
        camera: The camera.
        slam_map: The map.
        covisibility: Covisible keyframes, cleared whenever the map changes.
        adjuster: Bundle adjustment.
        watch: Gathers stage times.

    Attributes:
        after_culling: Called with each keyframe that was taken out of the map, under ``Map.lock``.
    """

    def __init__(
        self,
        settings: Settings,
        camera: CameraModel,
        slam_map: Map,
        covisibility: CovisibilityGraph,
        adjuster: MapAdjuster,
        watch: Stopwatch,
        aligner: ObservationAligner | None = None,
    ) -> None:
        self.settings, self.camera, self.map = settings, camera, slam_map
        self.covisibility, self.adjuster, self.watch = covisibility, adjuster, watch
        self.aligner = aligner
        self.after_culling: list[Callable[[int], None]] = []

    def process(self, k: int) -> None:
        """Cull, create, merge, adjust around the new keyframe ``k``.

        The map's lock is taken for one short step after the other, so that a tracker beside it waits for one at most.

        Raises:
            MappingStopped: If ``Map.steps`` was told to stop.
        """
        watch = self.watch
        with watch("point_culling"), self.map.steps:
            cull_new_points(self.map, k, mono=self.camera.mono)
        with watch("triangulation"):
            self._triangulate(k)
        with watch("merging"):
            self._merge_duplicates(k)
        if self.aligner is not None:
            with watch("alignment"), self.map.steps:
                self.aligner.align(k)
        self._changed()
        if self.settings.optimisation.local_ba and len(self._mapped(k)) > 2:
            with watch("local_ba"):
                self.adjuster.adjust_locally(k)
            self._changed()
        with watch("keyframe_culling"):
            self._cull_keyframes(k)
        self._changed()

    def _changed(self) -> None:
        with self.map.steps:
            self.covisibility.clear()

    def _mapped(self, k: int) -> IntArray:
        """Return the keyframes of the map of ``k``, which need not be the current one if the mapper lags behind."""
        with self.map.steps:
            return self.map.alive(int(self.map.keyframes.map_id[k]))

    def _neighbours(self, k: int) -> IntArray:
        return self.covisibility.of(k)[: self.settings.mapping.neighbours_in(mono=self.camera.mono)]

    def _triangulate(self, k: int) -> None:
        slam_map = self.map
        with slam_map.steps:
            neighbours = self._neighbours(k).tolist()
        created = [np.zeros(0, np.int64)]
        for n in neighbours:
            with slam_map.steps:
                created.append(create_points(slam_map, self.camera, k, n))
        new = np.concatenate(created)
        if len(new):
            with slam_map.steps:
                slam_map.refresh(new)
                slam_map.probation.append((k, new))

    def _merge_duplicates(self, k: int) -> None:
        slam_map = self.map
        with slam_map.steps:
            targets = dict.fromkeys(int(n) for n in self._neighbours(k))
            for n in list(targets):
                targets.update(
                    dict.fromkeys(int(m) for m in self.covisibility.of(n)[:_SECOND_NEIGHBOURS] if int(m) != k)
                )
        for target in targets:
            with slam_map.steps:
                points = slam_map.points_of(k)
                merge_duplicates(slam_map, self.camera, target, points[points >= 0])
        with slam_map.steps:
            if targets:
                merge_duplicates(slam_map, self.camera, k, slam_map.seen_by(np.array(list(targets))))
            points = slam_map.points_of(k)
            slam_map.refresh(points[points >= 0])

    def _cull_keyframes(self, k: int) -> None:
        """Remove keyframes whose points three others see as well or better (LocalMapping::KeyFrameCulling)."""
        first = int(self._mapped(k)[0])
        with self.map.steps:
            candidates = self.covisibility.of(k).tolist()
        for candidate in candidates:
            # A later keyframe waits to be mapped itself.
            if candidate == first or candidate >= k:
                continue
            with self.map.steps:
                self._cull_if_redundant(candidate)

    def _cull_if_redundant(self, candidate: int) -> None:
        slam_map = self.map
        close = 0.0 if self.camera.mono else self.camera.close_depth
        if not is_redundant(slam_map, candidate, self.settings.mapping.redundancy, close):
            return
        parents = self.covisibility.ranked(candidate, 1)[0]
        parents = parents[parents != candidate]
        slam_map.cull_keyframe(candidate, int(parents[0]))
        for callback in self.after_culling:
            callback(candidate)
