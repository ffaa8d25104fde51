"""Bundle adjustment of the whole map."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel, measurements
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_correction import Correction, apply
from prgbd.plugins.slam.orb_gtsam.mapping.local_mapper import LocalMapper
from prgbd.plugins.slam.orb_gtsam.optimisation.full_bundle_adjustment import full_bundle_adjustment
from prgbd.plugins.slam.orb_gtsam.settings import Settings


def adjust_map(
    slam_map: Map,
    camera: CameraModel,
    settings: Settings,
    mapper: LocalMapper,
    *,
    only: int | None = None,
    backend: Literal["gtsam", "numba"] | None = None,
) -> dict[str, Any]:
    """Adjust every map by itself; return what was done, for the statistics.

    Keyframes and points move, outliers lose their observation. A map with too many keyframes is left as it is.

    Args:
        slam_map: The map.
        camera: The camera.
        settings: Thresholds.
        mapper: Removes observations.
        only: The one map to adjust.
        backend: Solver in place of ``full_ba_backend``.
    """
    kf, pts = slam_map.keyframes, slam_map.points
    chosen: Literal["gtsam", "numba"] = backend or ("numba" if settings.full_ba_backend == "numba" else "gtsam")
    notes: list[dict[str, Any]] = []
    for map_id in slam_map.map_ids() if only is None else [only]:
        keyframes = np.flatnonzero(~kf.bad[: kf.count] & (kf.map_id[: kf.count] == map_id))
        if len(keyframes) < 2:
            continue
        if len(keyframes) > settings.full_ba_keyframes:
            notes.append({"map": map_id, "keyframes": len(keyframes), "skipped": "more than full_ba_keyframes"})
            continue
        with slam_map.lock:
            points = slam_map.seen_by(keyframes)
            seen = slam_map.observations(points)
            column = np.full(kf.count, -1, np.int64)
            column[keyframes] = np.arange(len(keyframes))
            seen = seen[column[seen[:, 0]] >= 0]
            at, row = seen[:, 0], seen[:, 1]
            fixed = np.zeros(len(keyframes), np.bool_)
            # A monocular map has no scale of its own: a second fixed pose keeps it.
            fixed[: 2 if camera.mono else 1] = True
            problem = (
                kf.cTw[keyframes],
                fixed,
                pts.xyz[points],
                column[at],
                np.ascontiguousarray(seen[:, 2]),
                measurements(kf.uv[at, row], kf.u_right[at, row]),
                camera.weights(kf.octave[at, row], kf.depth[at, row]),
                *camera.intrinsics,
            )
        result = full_bundle_adjustment(
            *problem,
            iterations=settings.full_ba_iterations,
            backend=chosen,
        )
        with slam_map.lock:
            apply(slam_map, int(keyframes[-1]), Correction(keyframes, inverse(result.cTw), np.ones(len(keyframes))))
            pts.xyz[points] = result.xyz
            mapper.drop_observations(seen[~result.inlier])
            slam_map.refresh(points[~pts.bad[points]])
        notes.append(
            {
                "map": map_id,
                "keyframes": len(keyframes),
                "points": len(points),
                "observations": len(seen),
                "outliers": int(np.count_nonzero(~result.inlier)),
                "initial_cost": float(result.initial_cost),
                "final_cost": float(result.final_cost),
            }
        )
    return {"backend": chosen, "maps": notes}
