"""Bundle adjustment of the whole map."""

from __future__ import annotations

from typing import Any

import numpy as np

from prgbd.plugins.slam.orb_gtsam.full_bundle_adjustment import full_bundle_adjustment
from prgbd.plugins.slam.orb_gtsam.local_mapping import LocalMapper
from prgbd.plugins.slam.orb_gtsam.mapping import Map
from prgbd.plugins.slam.orb_gtsam.rig import Rig, measurements
from prgbd.plugins.slam.orb_gtsam.settings import Settings


def adjust_map(world: Map, rig: Rig, settings: Settings, mapper: LocalMapper) -> dict[str, Any]:
    """Adjust every map by itself; return what was done, for the statistics.

    Keyframes and points move, outliers lose their observation. A map with too many keyframes is left as it is.
    """
    kf, pts = world.keyframes, world.points
    notes: list[dict[str, Any]] = []
    for map_id in range(world.current_map + 1):
        keyframes = np.flatnonzero(~kf.bad[: kf.count] & (kf.map_id[: kf.count] == map_id))
        if len(keyframes) < 2:
            continue
        if len(keyframes) > settings.full_ba_keyframes:
            notes.append({"map": map_id, "keyframes": len(keyframes), "skipped": "more than full_ba_keyframes"})
            continue
        points = world.seen_by(keyframes)
        seen = world.observations(points)
        at, row = seen[:, 0], seen[:, 1]
        column = np.full(kf.count, -1, np.int64)
        column[keyframes] = np.arange(len(keyframes))
        fixed = np.zeros(len(keyframes), np.bool_)
        # A monocular map has no scale of its own: a second fixed pose keeps it.
        fixed[: 2 if rig.mono else 1] = True
        result = full_bundle_adjustment(
            kf.cTw[keyframes],
            fixed,
            pts.xyz[points],
            column[at],
            np.ascontiguousarray(seen[:, 2]),
            measurements(kf.uv[at, row], kf.u_right[at, row]),
            rig.inverse_variance[kf.octave[at, row]],
            *rig.intrinsics,
            iterations=settings.full_ba_iterations,
            backend="numba" if settings.full_ba_backend == "numba" else "gtsam",
        )
        for k, cTw in zip(keyframes.tolist(), result.cTw, strict=True):
            world.set_pose(k, cTw)
        pts.xyz[points] = result.xyz
        mapper.drop_observations(seen[~result.inlier])
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
    return {"backend": settings.full_ba_backend, "maps": notes}
