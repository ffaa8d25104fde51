"""The local mapper: what happens to the map after each new keyframe."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel, measurements
from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.kernels import kernel
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.locking import FairLock
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.merging import merge_duplicates
from prgbd.plugins.slam.orb_gtsam.mapping.triangulation import create_points
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_adjustment import BundleResult, local_bundle_adjustment
from prgbd.plugins.slam.orb_gtsam.settings import Settings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Solver = Callable[[], BundleResult]

# ORB-SLAM2 (LocalMapping::SearchInNeighbors): neighbours of a neighbour that take part in fusion.
_SECOND_NEIGHBOURS = 5
# Fewer points do not tell the scale of a keyframe's depth.
_LEAST_RATIOS = 20
# A point may leave probation this many keyframes after its creation (LocalMapping::MapPointCulling).
_PROBATION = 3


class MappingStopped(Exception):
    """The mapper was told to stop in the middle of a keyframe."""


class LocalMapper:
    """Adds keyframes to the map and keeps it clean and consistent around them.

    Args:
        settings: Thresholds.
        camera: The camera.
        slam_map: The map.
        covisibility: Covisible keyframes, cleared whenever the map changes.
        watch: Gathers stage times.

    Attributes:
        after_culling: Called with each keyframe that was taken out of the map, under ``Map.lock``.
    """

    def __init__(
        self, settings: Settings, camera: CameraModel, slam_map: Map, covisibility: CovisibilityGraph, watch: Stopwatch
    ) -> None:
        self.settings, self.camera, self.map, self.covisibility, self.watch = (
            settings,
            camera,
            slam_map,
            covisibility,
            watch,
        )
        self.after_culling: list[Callable[[int], None]] = []
        self.keyframes_added = 0
        self.keyframes_culled = 0
        self.points_culled = 0
        self.depths_rejected = 0
        self._recent: deque[tuple[int, IntArray]] = deque()
        self._stopped = False

    def add_keyframe(
        self, frame_index: int, timestamp: float, cTw: FloatArray, features: Features, points: IntArray
    ) -> int:
        """Add a keyframe with its points, and new points at its measured depth; return its number."""
        slam_map = self.map
        k = slam_map.add_keyframe(frame_index, timestamp, cTw, features, points)
        self.keyframes_added += 1
        if not self.camera.mono:
            rows = self._depth_rows(k)
            new = slam_map.add_points(k, rows, self.camera.lift(features, rows, inverse(cTw), self._depth_ratio(k)))
            self._recent.append((k, new))
        seen = slam_map.points_of(k)
        slam_map.refresh(seen[seen >= 0])
        self.covisibility.clear()
        return k

    def _depth_ratio(self, k: int) -> float:
        """Median of measured depth over map depth of the points that keyframe ``k`` sees; 1 for a sensor.

        A network's scale wanders: new points take the scale of the map around them, and the weak weight of all depths
        together holds the scale of the map.
        """
        slam_map = self.map
        rows = np.flatnonzero((slam_map.points_of(k) >= 0) & (slam_map.features(k).depth > 0))
        if self.camera.noise.is_zero or len(rows) < _LEAST_RATIOS:
            return 1.0
        cTw = slam_map.keyframes.cTw[k]
        z = slam_map.points.xyz[slam_map.points_of(k)[rows]] @ cTw[2, :3] + cTw[2, 3]
        front = z > 1e-6
        return float(np.median(slam_map.features(k).depth[rows[front]] / z[front])) if front.any() else 1.0

    def lift_all(self, k: int) -> IntArray:
        """Give every keypoint of a first keyframe that has depth its point (Tracking::StereoInitialization)."""
        slam_map = self.map
        features = slam_map.features(k)
        rows = np.flatnonzero((features.depth > 0) & (slam_map.points_of(k) < 0))
        new = slam_map.add_points(k, rows, self.camera.lift(features, rows, inverse(slam_map.keyframes.cTw[k])))
        slam_map.refresh(new)
        return slam_map.points_of(k).copy()

    def _depth_rows(self, k: int) -> IntArray:
        """Keypoints to lift: all that are close, at least the closest ones, of those without a point."""
        depth = self.map.features(k).depth
        order = np.argsort(depth, kind="stable")
        order = order[depth[order] > 0]
        wanted = (depth[order] <= self.camera.close_depth) | (np.arange(len(order)) < self.settings.keyframe_points)
        order = order[wanted]
        return order[self.map.points_of(k)[order] < 0]

    def process(self, k: int) -> None:
        """Cull, create, fuse, adjust around the new keyframe ``k``.

        The map's lock is taken for one short step after the other, so that a tracker beside it waits for one at most.
        """
        watch = self.watch
        with watch("point_culling"), self._step():
            self._cull_points(k)
        with watch("triangulation"):
            self._triangulate(k)
        with watch("fusion"):
            self._fuse(k)
        self._changed()
        if self.settings.local_ba and len(self._mapped(k)) > 2:
            with watch("local_ba"):
                self.adjust(k)
            self._changed()
        with watch("keyframe_culling"):
            self._cull_keyframes(k)
        self._changed()

    def stop(self) -> None:
        """Let ``process``, which may be running in another thread, end before its next step by ``MappingStopped``."""
        self._stopped = True

    def _step(self) -> FairLock:
        if self._stopped:
            raise MappingStopped
        return self.map.lock

    def _changed(self) -> None:
        with self._step():
            self.covisibility.clear()

    def _mapped(self, k: int) -> IntArray:
        """Return the keyframes of the map of ``k``, which need not be the current one if the mapper lags behind."""
        with self._step():
            return self.map.alive(int(self.map.keyframes.map_id[k]))

    def _neighbours(self, k: int) -> IntArray:
        count = self.settings.neighbours_mono if self.camera.mono else self.settings.neighbours
        return self.covisibility.of(k)[:count]

    def _cull_points(self, k: int) -> None:
        """Remove new points that are rarely found or seldom observed (LocalMapping::MapPointCulling)."""
        pts = self.map.points
        least = 2 if self.camera.mono else 3
        kept: deque[tuple[int, IntArray]] = deque()
        for created, points in self._recent:
            points = points[~pts.bad[points]]
            bad = pts.found[points] < self.settings.min_found_ratio * pts.visible[points]
            if k - created >= 2:
                bad |= self.map.observation_counts(points, double=not self.camera.mono) <= least
            self.map.remove_points(points[bad])
            self.points_culled += int(bad.sum())
            if k - created < _PROBATION:
                kept.append((created, points[~bad]))
        self._recent = kept

    def _triangulate(self, k: int) -> None:
        slam_map = self.map
        with self._step():
            neighbours = self._neighbours(k).tolist()
        created = [np.zeros(0, np.int64)]
        for n in neighbours:
            with self._step():
                created.append(create_points(slam_map, self.camera, self.settings, k, n))
        new = np.concatenate(created)
        if len(new):
            with self._step():
                slam_map.refresh(new)
            self._recent.append((k, new))

    def _fuse(self, k: int) -> None:
        slam_map = self.map
        with self._step():
            targets = dict.fromkeys(int(n) for n in self._neighbours(k))
            for n in list(targets):
                targets.update(
                    dict.fromkeys(int(m) for m in self.covisibility.of(n)[:_SECOND_NEIGHBOURS] if int(m) != k)
                )
        for target in targets:
            with self._step():
                points = slam_map.points_of(k)
                merge_duplicates(slam_map, self.camera, self.settings, target, points[points >= 0])
        with self._step():
            if targets:
                merge_duplicates(slam_map, self.camera, self.settings, k, slam_map.seen_by(np.array(list(targets))))
            points = slam_map.points_of(k)
            slam_map.refresh(points[points >= 0])

    def adjust(self, k: int) -> None:
        """Bundle adjustment of ``k``, its covisible keyframes and all their points."""
        slam_map = self.map
        with self._step():
            keyframes, fixed, points, seen, lone, solve = self._local_problem(k)
            count, before = slam_map.keyframes.count, slam_map.keyframes.cTw.copy()
        # On copies: the tracker goes on meanwhile, and may add keyframes.
        result = solve()
        with self._step():
            for i, keyframe in enumerate(keyframes.tolist()):
                if not fixed[i]:
                    slam_map.set_pose(keyframe, result.cTw[i])
            slam_map.points.xyz[points] = result.xyz
            self._carry_along(k, before[k], count)
            self._carry_lone_points(lone, before)
            self.drop_depths(seen[result.depth_rejected & result.inlier])
            self.drop_observations(seen[~result.inlier])
            moved = np.concatenate([points, lone[:, 1]])
            slam_map.refresh(moved[~slam_map.points.bad[moved]], descriptors=False)

    def _carry_along(self, k: int, before: FloatArray, count: int) -> None:
        """Move keyframes that came while ``k`` was adjusted, from number ``count`` on, and their points with ``k``."""
        slam_map, kf, pts = self.map, self.map.keyframes, self.map.points
        late = [n for n in range(count, kf.count) if kf.map_id[n] == kf.map_id[k]]
        if not late:
            return
        oldTnew = inverse(before) @ kf.cTw[k]
        newTold = inverse(oldTnew)
        for n in late:
            slam_map.set_pose(n, kf.cTw[n] @ oldTnew)
            own = slam_map.points_of(n)
            own = own[own >= 0]
            own = own[pts.created[own] == n]
            pts.xyz[own] = pts.xyz[own] @ newTold[:3, :3].T + newTold[:3, 3]

    def _carry_lone_points(self, lone: IntArray, before: FloatArray) -> None:
        """Move points that one keyframe alone sees, rows ``(keyframe, point)``, with it from its pose ``before``."""
        if len(lone) == 0:
            return
        xyz, (at, points) = self.map.points.xyz, lone.T
        oldTnew = inverse(before[at]) @ self.map.keyframes.cTw[at]
        newTold = inverse(oldTnew)
        xyz[points] = np.einsum("nij,nj->ni", newTold[:, :3, :3], xyz[points]) + newTold[:, :3, 3]

    def _local_problem(self, k: int) -> tuple[IntArray, NDArray[np.bool_], IntArray, IntArray, IntArray, Solver]:
        """Collect keyframes, which of them are fixed, points, observations, lone points, and the solver with copies.

        A point that one keyframe alone sees with a sensor's depth says nothing about poses, so it stays out of the
        problem. With pseudo depth it stays in: the map sets its depth at first, and the network's pulls at it.
        """
        slam_map, settings, kf = self.map, self.settings, self.map.keyframes
        first = int(self._mapped(k)[0])
        local = np.append(k, self.covisibility.of(k)[: settings.local_ba_keyframes - 1])
        points = slam_map.seen_by(local)
        seen = slam_map.observations(points)
        alone = (np.bincount(seen[:, 2], minlength=len(points)) == 1) & self.camera.noise.is_zero
        single = alone[seen[:, 2]]
        lone = np.stack([seen[single, 0], points[seen[single, 2]]], axis=1)
        seen = seen[~single]
        points, renumbered = points[~alone], np.cumsum(~alone) - 1
        seen[:, 2] = renumbered[seen[:, 2]]
        counts = np.bincount(seen[:, 0], minlength=kf.count)
        counts[local] = 0
        others = np.flatnonzero(counts)
        others = others[np.argsort(-counts[others], kind="stable")][: settings.local_ba_fixed]
        keyframes = np.concatenate([local, others])
        fixed = np.arange(len(keyframes)) >= len(local)
        fixed |= keyframes == first
        if not fixed.any():
            fixed[np.argmin(keyframes)] = True
        column = np.full(kf.count, -1, np.int64)
        column[keyframes] = np.arange(len(keyframes))
        seen = seen[column[seen[:, 0]] >= 0]
        at, row = seen[:, 0], seen[:, 1]
        solve = partial(
            local_bundle_adjustment,
            kf.cTw[keyframes],
            fixed,
            slam_map.points.xyz[points],
            column[at],
            np.ascontiguousarray(seen[:, 2]),
            measurements(kf.uv[at, row], kf.u_right[at, row]),
            self.camera.weights(kf.octave[at, row], kf.depth[at, row]),
            *self.camera.intrinsics,
            depth_fallback=self.camera.noise.fallback,
            iterations=settings.local_ba_iterations,
            tolerance=settings.local_ba_tolerance,
        )
        return keyframes, fixed, points, seen, lone, solve

    def drop_depths(self, disagreeing: IntArray) -> None:
        """Make observations ((M, 3) as from ``Map.observations``) monocular for good: their depth is wrong."""
        self.map.keyframes.u_right[disagreeing[:, 0], disagreeing[:, 1]] = -1.0
        self.depths_rejected += len(disagreeing)

    def drop_observations(self, outliers: IntArray) -> None:
        """Remove observations ((M, 3) as from ``Map.observations``), and points that keep at most two."""
        slam_map = self.map
        points = np.unique(slam_map.keyframes.point[outliers[:, 0], outliers[:, 1]])
        points = points[points >= 0]
        slam_map.forget(np.ascontiguousarray(outliers[:, 0]), np.ascontiguousarray(outliers[:, 1]))
        few = slam_map.observation_counts(points, double=not self.camera.mono) <= 2
        slam_map.remove_points(points[few])

    def _cull_keyframes(self, k: int) -> None:
        """Remove keyframes whose points three others see as well or better (LocalMapping::KeyFrameCulling)."""
        first = int(self._mapped(k)[0])
        with self._step():
            candidates = self.covisibility.of(k).tolist()
        for candidate in candidates:
            # A later keyframe waits to be mapped itself.
            if candidate == first or candidate >= k:
                continue
            with self._step():
                self._cull_if_redundant(candidate)

    def _cull_if_redundant(self, candidate: int) -> None:
        slam_map, kf = self.map, self.map.keyframes
        share = _redundant_share(
            kf.point,
            kf.following,
            kf.octave,
            kf.depth,
            slam_map.points.head,
            candidate,
            0.0 if self.camera.mono else self.camera.close_depth,
        )
        if share <= self.settings.redundancy:
            return
        parents = slam_map.covisible(candidate, 1)[0]
        parents = parents[parents != candidate]
        slam_map.cull_keyframe(candidate, int(parents[0]))
        self.keyframes_culled += 1
        for callback in self.after_culling:
            callback(candidate)

    def statistics(self) -> dict[str, Any]:
        """Return counts for the result."""
        return {
            "keyframes_added": self.keyframes_added,
            "keyframes_culled": self.keyframes_culled,
            "points_created": self.map.points_created,
            "points_culled": self.points_culled,
            "depths_rejected": self.depths_rejected,
        }


@kernel()
def _redundant_share(
    point_of: np.ndarray,
    following: np.ndarray,
    octave: np.ndarray,
    depth: np.ndarray,
    head: np.ndarray,
    k: int,
    close: float,
) -> float:
    """Share of a keyframe's (close) points that at least three others see at the same or a finer scale."""
    capacity = point_of.shape[1]
    flat_next, flat_octave = following.reshape(-1), octave.reshape(-1)
    points, redundant = 0, 0
    for i in range(capacity):
        p = point_of[k, i]
        if p < 0 or (close > 0 and (depth[k, i] <= 0 or depth[k, i] > close)):
            continue
        points += 1
        others, at = 0, head[p]
        while at >= 0:
            if at // capacity != k and flat_octave[at] <= octave[k, i] + 1:
                others += 1
            at = flat_next[at]
        redundant += others >= 3
    return redundant / points if points > 0 else 0.0
