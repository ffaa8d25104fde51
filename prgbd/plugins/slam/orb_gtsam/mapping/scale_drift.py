"""The drift of a map's scale, found and taken out with the help of the network's depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.geometry.scale_smoothing import split_scale
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_bundle import MapBundle, collect_bundle
from prgbd.plugins.slam.orb_gtsam.map.map_correction import Correction, apply, follow_baseline
from prgbd.plugins.slam.orb_gtsam.optimisation.scale_covariance import ScaleCovariance

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Keyframes without which there is nothing to smooth, and those at which the scale is measured at most.
_LEAST_KEYFRAMES, _MOST_KEYFRAMES = 3, 600
# Keyframes that must see a point, and depths that a keyframe must have, to tell a scale.
_LEAST_VIEWS, _LEAST_DEPTHS = 3, 10
# Relative depth that a point may be off although its rays meet well.
_ACCURATE = 0.05
# By how much the scale drifts more than pixels that err independently would let it: on six recordings its change over
# 50 to 200 keyframes was 13 to 31 standard deviations, as the errors of neighbouring keyframes are much the same.
_OVERCONFIDENCE = 20.0
_IN_FRONT = 1e-6


def correct_scale(slam_map: Map, camera: CameraModel) -> list[dict[str, Any]]:
    """Take the drift of scale out of every map; the caller holds ``Map.lock``.

    What depth says of the scale of a keyframe is the map's drift plus the network's wander. How much of it is drift is
    told by the covariance of bundle adjustment: a map that geometry holds stiffly keeps its shape whatever a network
    says, and one that it holds loosely follows the network over long distances. All of it gets the network's unit.

    Returns:
        What was done to each map, for the statistics.
    """
    notes = []
    for map_id in slam_map.map_ids():
        keyframes = slam_map.alive(map_id)
        if len(keyframes) >= _LEAST_KEYFRAMES:
            notes.append({"map": map_id} | _correct_map(slam_map, camera, keyframes))
    return notes


def give_depth_back(slam_map: Map, camera: CameraModel) -> None:
    """Undo what the depths of keyframes were divided by; their right columns follow. The caller holds the lock."""
    kf = slam_map.keyframes
    kf.depth[: kf.count] *= np.exp(kf.log_depth_scale[: kf.count]).astype(np.float32)[:, None]
    kf.log_depth_scale[: kf.count] = 0.0
    follow_baseline(slam_map, camera)


def _correct_map(slam_map: Map, camera: CameraModel, keyframes: IntArray) -> dict[str, Any]:
    bundle = _bundle(slam_map, camera, keyframes)
    covariance = ScaleCovariance(bundle.problem)
    weight = _weights(slam_map, bundle, covariance.depth_variance)
    log_ratio = _log_ratios(slam_map, bundle, weight)
    known = np.flatnonzero(np.isfinite(log_ratio))
    if len(known) < _LEAST_KEYFRAMES:
        return {"skipped": "too few depths"}
    chosen = known[np.unique(np.linspace(0, len(known) - 1, _MOST_KEYFRAMES).astype(int))]
    drift_covariance = _OVERCONFIDENCE**2 * covariance.of(weight, chosen)
    if not np.isfinite(drift_covariance).all():
        return {"skipped": "geometry is too weak to be judged"}
    split = split_scale(log_ratio[chosen], drift_covariance, chosen.astype(np.float64), arbitrary=camera.affine)
    drift = np.interp(np.arange(len(keyframes)), chosen, split.drift)
    apply(slam_map, int(keyframes[-1]), _rescaled(slam_map, keyframes, np.exp(drift)))
    return {
        "keyframes": len(keyframes),
        "network_sigma": split.sigma,
        "network_length": split.length,
        "geometry_sigma": _change(drift_covariance),
        "drift": float(np.ptp(drift)),
    }


def _change(covariance: FloatArray) -> float:
    """Return the standard deviation of the change of scale from the first keyframe to the last."""
    return float(np.sqrt(max(0.0, covariance[0, 0] + covariance[-1, -1] - 2 * covariance[0, -1])))


def _bundle(slam_map: Map, camera: CameraModel, keyframes: IntArray) -> MapBundle:
    """Collect what the keyframes see in front of them of points that two of them see at least."""
    kf, points = slam_map.keyframes, slam_map.seen_by(keyframes)
    seen = slam_map.observations(points)
    z = np.einsum("nj,nj->n", kf.cTw[seen[:, 0], 2, :3], slam_map.points.xyz[points[seen[:, 2]]])
    seen = seen[(z + kf.cTw[seen[:, 0], 2, 3] > _IN_FRONT) & np.isin(seen[:, 0], keyframes)]
    several = np.bincount(seen[:, 2], minlength=len(points)) > 1
    seen = seen[several[seen[:, 2]]]
    seen[:, 2] = (np.cumsum(several) - 1)[seen[:, 2]]
    fixed = np.zeros(len(keyframes), np.bool_)
    return collect_bundle(slam_map, camera, keyframes, fixed, points[several], seen, with_depth=False)


def _weights(slam_map: Map, bundle: MapBundle, depth_variance: FloatArray) -> FloatArray:
    """Return what every observation counts in the scale of its keyframe.

    Near points count most, as for a stereo camera: a network's scale wanders least there, and they are placed best.
    """
    at, row, point = bundle.observations.T
    depth = slam_map.keyframes.depth[at, row].astype(np.float64)
    views = np.bincount(point, minlength=len(bundle.points))[point]
    good = (depth > 0) & (views >= _LEAST_VIEWS)
    return np.where(good, 1.0 / (np.where(good, depth, 1.0) ** 2 * (depth_variance + _ACCURATE**2)), 0.0)


def _log_ratios(slam_map: Map, bundle: MapBundle, weight: FloatArray) -> FloatArray:
    """Return the weighted median of the logarithm of measured depth over map depth, (K,), NaN with too few depths."""
    kf, problem = slam_map.keyframes, bundle.problem
    cTw, xyz = problem.cTw[problem.pose_row], problem.xyz[problem.point_row]
    z = np.einsum("nj,nj->n", cTw[:, 2, :3], xyz) + cTw[:, 2, 3]
    at, row, _ = bundle.observations.T
    rows = np.flatnonzero(weight > 0)
    logs = np.log(kf.depth[at[rows], row[rows]] / z[rows]) + kf.log_depth_scale[at[rows]]
    out = np.full(len(bundle.keyframes), np.nan)
    order = np.lexsort((logs, problem.pose_row[rows]))
    pose, logs, share = problem.pose_row[rows][order], logs[order], weight[rows][order]
    for k, own in enumerate(np.split(np.arange(len(order)), np.searchsorted(pose, np.arange(1, len(out))))):
        if len(own) >= _LEAST_DEPTHS:
            total = np.cumsum(share[own])
            out[k] = logs[own[np.searchsorted(total, 0.5 * total[-1])]]
    return out


def _rescaled(slam_map: Map, keyframes: IntArray, scale: FloatArray) -> Correction:
    """Return the correction that makes every step between keyframes longer by the scale there."""
    wTc = inverse(slam_map.keyframes.cTw[keyframes])
    steps = np.diff(wTc[:, :3, 3], axis=0) * np.sqrt(scale[1:] * scale[:-1])[:, None]
    wTc[1:, :3, 3] = wTc[0, :3, 3] + np.cumsum(steps, axis=0)
    return Correction(keyframes, wTc, scale)
