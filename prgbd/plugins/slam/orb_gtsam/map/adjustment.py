"""Bundle adjustment of the map: around one keyframe, and of whole maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.culling import drop_depths, drop_observations
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_bundle import MapBundle, collect_bundle
from prgbd.plugins.slam.orb_gtsam.map.map_correction import (
    Correction,
    apply,
    carry_late_keyframes,
    carry_lone_points,
)
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleResult
from prgbd.plugins.slam.orb_gtsam.optimisation.solver import BundleSolver
from prgbd.plugins.slam.orb_gtsam.settings import OptimisationOptions

IntArray = NDArray[np.int64]

# ORB-SLAM2 (Optimizer::LocalBundleAdjustment): iterations before and after outliers are removed. It holds every other
# keyframe fixed that sees the points, and does not ask for convergence; here those that see most of them, until the
# cost decreases by less than a share.
LOCAL_ITERATIONS, FIXED_KEYFRAMES, TOLERANCE = (5, 10), 30, 1e-3
# ORB-SLAM2 (LoopClosing::RunGlobalBundleAdjustment).
GLOBAL_ITERATIONS = 10


class MapAdjuster:
    """Adjusts keyframes and points of a map; solvers work on copies, and the map is locked only to read and to write.

    Args:
        options: Which keyframes take part.
        camera: The camera.
        slam_map: The map.
        covisibility: Covisible keyframes.
        solver: Bundle adjustment.
    """

    def __init__(
        self,
        options: OptimisationOptions,
        camera: CameraModel,
        slam_map: Map,
        covisibility: CovisibilityGraph,
        solver: BundleSolver,
    ) -> None:
        self.options, self.camera, self.map = options, camera, slam_map
        self.covisibility, self.solver = covisibility, solver

    def adjust_locally(self, k: int) -> None:
        """Bundle adjustment of ``k``, its covisible keyframes and all their points.

        Raises:
            MappingStopped: If the mapper's side was told to stop.
        """
        slam_map = self.map
        with slam_map.steps:
            bundle, lone = self._local_bundle(k)
            count, before = slam_map.keyframes.count, slam_map.keyframes.cTw.copy()
        result = self.solver.refine_locally(
            bundle.problem,
            depth_fallback=self.camera.noise.fallback,
            iterations=LOCAL_ITERATIONS,
            tolerance=TOLERANCE,
        )
        with slam_map.steps:
            for row in np.flatnonzero(~bundle.problem.fixed).tolist():
                slam_map.set_pose(int(bundle.keyframes[row]), result.cTw[row])
            slam_map.points.xyz[bundle.points] = result.xyz
            carry_late_keyframes(slam_map, k, before[k], count)
            carry_lone_points(slam_map, lone, before)
            drop_depths(slam_map, bundle.observations[result.depth_rejected & result.inlier])
            drop_observations(slam_map, bundle.observations[~result.inlier], double=not self.camera.mono)
            moved = np.concatenate([bundle.points, lone[:, 1]])
            slam_map.refresh(moved[~slam_map.points.bad[moved]], descriptors=False)

    def _local_bundle(self, k: int) -> tuple[MapBundle, IntArray]:
        """Collect keyframes, points and observations around ``k``; and lone points, rows ``(keyframe, point)``.

        A point that one keyframe alone sees with a sensor's depth says nothing about poses, so it stays out of the
        problem. With pseudo depth it stays in: the map sets its depth at first, and the network's pulls at it.
        """
        slam_map, kf = self.map, self.map.keyframes
        local = np.append(k, self.covisibility.of(k)[: self.options.local_ba_keyframes - 1])
        points = slam_map.seen_by(local)
        seen = slam_map.observations(points)
        alone = (np.bincount(seen[:, 2], minlength=len(points)) == 1) & self.camera.noise.is_zero
        single = alone[seen[:, 2]]
        lone = np.stack([seen[single, 0], points[seen[single, 2]]], axis=1)
        seen = seen[~single]
        seen[:, 2] = (np.cumsum(~alone) - 1)[seen[:, 2]]
        counts = np.bincount(seen[:, 0], minlength=kf.count)
        counts[local] = 0
        others = np.flatnonzero(counts)
        others = others[np.argsort(-counts[others], kind="stable")][:FIXED_KEYFRAMES]
        keyframes = np.concatenate([local, others])
        fixed = np.arange(len(keyframes)) >= len(local)
        fixed |= keyframes == slam_map.alive(int(kf.map_id[k]))[0]
        if not fixed.any():
            fixed[np.argmin(keyframes)] = True
        return collect_bundle(slam_map, self.camera, keyframes, fixed, points[~alone], seen), lone

    def adjust_globally(self, only: int | None = None) -> dict[str, Any]:
        """Adjust every map by itself, or the map ``only``; return what was done, for the statistics.

        Keyframes and points move, outliers lose their observation. A map with too many keyframes is left as it is.
        """
        chosen = self.map.map_ids() if only is None else [only]
        notes = [self._adjust_map(map_id) for map_id in chosen if len(self.map.alive(map_id)) >= 2]
        return {"backend": self.options.solver, "maps": notes}

    def _adjust_map(self, map_id: int) -> dict[str, Any]:
        slam_map, keyframes = self.map, self.map.alive(map_id)
        if len(keyframes) > self.options.full_ba_keyframes:
            return {"map": map_id, "keyframes": len(keyframes), "skipped": "more than full_ba_keyframes"}
        fixed = np.zeros(len(keyframes), np.bool_)
        # A monocular map has no scale of its own: a second fixed pose keeps it.
        fixed[: 2 if self.camera.mono else 1] = True
        with slam_map.lock:
            bundle = collect_bundle(slam_map, self.camera, keyframes, fixed, slam_map.seen_by(keyframes))
        result = self.solver.refine_globally(bundle.problem, iterations=GLOBAL_ITERATIONS)
        with slam_map.lock:
            self._take_globally(bundle, result)
        return {
            "map": map_id,
            "keyframes": len(keyframes),
            "points": len(bundle.points),
            "observations": len(bundle.observations),
            "outliers": int(np.count_nonzero(~result.inlier)),
            "initial_cost": float(result.initial_cost),
            "final_cost": float(result.final_cost),
        }

    def _take_globally(self, bundle: MapBundle, result: BundleResult) -> None:
        slam_map, keyframes = self.map, bundle.keyframes
        apply(slam_map, int(keyframes[-1]), Correction(keyframes, inverse(result.cTw), np.ones(len(keyframes))))
        slam_map.points.xyz[bundle.points] = result.xyz
        drop_observations(slam_map, bundle.observations[~result.inlier], double=not self.camera.mono)
        slam_map.refresh(bundle.points[~slam_map.points.bad[bundle.points]])
