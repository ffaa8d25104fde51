"""A part of the map as a problem of bundle adjustment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel, measurements
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleProblem

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class MapBundle:
    """A problem and the rows of the map that it came from.

    Attributes:
        keyframes: (K,) int64, the problem's poses.
        points: (P,) int64, its points.
        observations: (M, 3) int64 ``(keyframe, keypoint, position in points)``, its observations.
        problem: Copies of what the map holds.
    """

    keyframes: IntArray
    points: IntArray
    observations: IntArray
    problem: BundleProblem


def collect_bundle(
    slam_map: Map,
    camera: CameraModel,
    keyframes: IntArray,
    fixed: NDArray[np.bool_],
    points: IntArray,
    observations: IntArray | None = None,
    *,
    with_depth: bool = True,
) -> MapBundle:
    """Copy poses, points and what these keyframes see of these points; the caller holds ``Map.lock``.

    Args:
        slam_map: The map.
        camera: The camera.
        keyframes: (K,) int64.
        fixed: (K,) bool, keyframes that stay.
        points: (P,) int64.
        observations: (M, 3) as from ``Map.observations`` of ``points``, those by other keyframes among them; looked up
            if left out.
        with_depth: Whether measured depth takes part.
    """
    kf = slam_map.keyframes
    seen = slam_map.observations(points) if observations is None else observations
    column = np.full(kf.count, -1, np.int64)
    column[keyframes] = np.arange(len(keyframes))
    seen = seen[column[seen[:, 0]] >= 0]
    at, row = seen[:, 0], seen[:, 1]
    octave = kf.octave[at, row]
    weights = camera.weights(octave, kf.depth[at, row]) if with_depth else camera.inverse_variance[octave]
    problem = BundleProblem(
        cTw=kf.cTw[keyframes],
        fixed=fixed,
        xyz=slam_map.points.xyz[points],
        pose_row=column[at],
        point_row=np.ascontiguousarray(seen[:, 2]),
        uvr=measurements(kf.uv[at, row], kf.u_right[at, row] if with_depth else np.full(len(at), -1.0)),
        inv_sigma2=_with_precision(slam_map, at, row, points[seen[:, 2]], weights),
        camera=camera.intrinsics,
    )
    return MapBundle(keyframes, points, seen, problem)


def _with_precision(
    slam_map: Map, at: IntArray, row: IntArray, points: IntArray, weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weigh keypoints by how their patches agreed with those of the same point, where that was tried."""
    kf = slam_map.keyframes
    precision = np.where(kf.aligned[at, row] == points, kf.precision[at, row], np.float32(1.0))
    both = np.repeat(weights[:, None], 2, axis=1) if weights.ndim == 1 else weights
    return both * np.stack([precision, np.ones_like(precision)], axis=1)
