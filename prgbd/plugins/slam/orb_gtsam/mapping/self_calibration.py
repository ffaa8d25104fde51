"""Self-calibration: the focal length that the whole map agrees with best."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.camera.chi_square import CHI2_MONO
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_bundle import collect_bundle
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleState
from prgbd.plugins.slam.orb_gtsam.optimisation.solver import BundleSolver

log = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ITERATIONS = 20
_TOLERANCE = 1e-6
# First trial step of the relative focal length, the change at which the search ends, and its most bundle adjustments.
_STEP = 0.01
_PRECISION = 5e-4
_ROUNDS = 5
# The focal length stays within this many standard deviations of the given one.
_TRUST = 4.0
# A map must know the focal length this many times better than the user, or it says too little: errors that all
# keypoints share (matches of repeated texture, rolling shutter) would decide.
_BETTER = 4.0
# It must contradict the user by this many standard deviations: on made-up worlds, whose camera is known, such maps were
# wrong by up to 0.9 %, so what differs by less is left alone.
_CONTRADICTS = 1.5
# A map of fewer keyframes is not asked.
_LEAST_KEYFRAMES = 10


@dataclass(frozen=True)
class FocalLength:
    """What a map says about the focal length.

    Attributes:
        factor: Best focal length over that before.
        deviation: Its standard deviation, from the curvature of the cost and the spread of the errors.
        rounds: Bundle adjustments that it took.
    """

    factor: float
    deviation: float
    rounds: int


class _Search:
    """Bundle adjustments of one map at different focal lengths, each from the result of the last."""

    def __init__(self, state: BundleState, solver: BundleSolver, given: float, sigma: float) -> None:
        self.state, self.solver, self.given, self.sigma = state, solver, given, sigma
        self.focal = state.camera[:2].copy()
        self.rounds = 0
        # Variance of the errors over the assumed one; keypoints are placed better than a pixel, so it is below 1.
        self._excess = 1.0

    def slope(self, factor: float) -> float:
        """Adjust the map at this focal length and return the derivative of the least cost by the factor.

        At the minimum over poses and points their derivatives vanish, so that of the focal length alone is left.
        """
        state = self.state
        self.rounds += 1
        state.camera[:2] = self.focal * factor
        self.solver.minimise(state, state.usable, robust=True, iterations=_ITERATIONS, tolerance=_TOLERANCE)
        pose = state.poses[state.kf]
        p = np.einsum("nij,nj->ni", pose[:, :3, :3], state.points[state.pt]) + pose[:, :3, 3]
        seen = state.usable & (p[:, 2] > 1e-9)
        ray = p[seen, :2] / p[seen, 2:] * self.focal
        error = state.uvr[seen, :2] - (ray * factor + state.camera[2:4])
        weight = state.weight[seen, 0]
        chi2 = np.maximum(weight * (error**2).sum(axis=1), 1e-12)
        weight = weight * np.minimum(1.0, np.sqrt(CHI2_MONO / chi2))
        data = -float((weight * (error * ray).sum(axis=1)).sum())
        if self.rounds == 1:
            self._excess = float((weight * (error**2).sum(axis=1)).sum()) / self._freedom()
        return data / self._excess + (factor - self.given) / self.sigma**2

    def _freedom(self) -> int:
        """Return the degrees of freedom: two a keypoint, less three a point and six a pose."""
        state = self.state
        seen = int(np.count_nonzero(np.diff(state.first)))
        return max(2 * int(state.usable.sum()) - 3 * seen - 6 * state.free, 1)

    def run(self) -> FocalLength | None:
        """Find where the slope vanishes, by the secant method; None without reason to change it."""
        low, high = self.given - _TRUST * self.sigma, self.given + _TRUST * self.sigma
        factor, slope = 1.0, self.slope(1.0)
        trial = float(np.clip(factor - np.sign(slope) * _STEP, low, high))
        curvature = 0.0
        while self.rounds < _ROUNDS and abs(trial - factor) > _PRECISION:
            found = self.slope(trial)
            curvature = (found - slope) / (trial - factor)
            if not curvature > 0:
                return None
            factor, slope = trial, found
            trial = float(np.clip(factor - np.clip(slope / curvature, -2 * _STEP, 2 * _STEP), low, high))
        known = curvature > (_BETTER / self.sigma) ** 2
        contradicts = abs(factor - self.given) > _CONTRADICTS * self.sigma
        return FocalLength(factor, curvature**-0.5, self.rounds) if known and contradicts else None


def calibrate_focal_length(
    slam_map: Map, camera: CameraModel, solver: BundleSolver, map_id: int, sigma: float, given: float = 1.0
) -> FocalLength | None:
    """Refine the focal length together with poses and points of a map, by its pixels alone, and give it to ``camera``.

    Small errors of calibration and rectification look like a wrong focal length. They bend the trajectory in turns and
    change its scale there, far above the noise of the keypoints. A turn, or parallax in several directions, tells the
    focal length; where the motion does not (straight ahead), or where the given one fits, nothing changes.

    The pixels do not move; fx and fy keep their ratio. The length of the path stays, so that poses relative to
    keyframes stay valid. ORB-SLAM2 has no such step.

    Pseudo depth, whose errors of 15 % and more would outweigh the few per cent that a focal length is off, does not
    take part; its right columns stay as they are, so the virtual baseline is divided by the factor.

    Args:
        slam_map: The map; its keyframes and points move.
        camera: Gets the camera, and with pseudo depth the baseline that goes with it.
        solver: Bundle adjustment.
        map_id: Which of the maps.
        sigma: Relative standard deviation of the focal length that the user gave.
        given: That focal length over the present one.

    Returns:
        What was found, or None if the map has no reason to change anything; then nothing has changed.
    """
    pts = slam_map.points
    with slam_map.lock:
        keyframes = slam_map.alive(map_id)
        if len(keyframes) < _LEAST_KEYFRAMES:
            return None
        fixed = np.arange(len(keyframes)) == 0
        bundle = collect_bundle(slam_map, camera, keyframes, fixed, slam_map.seen_by(keyframes), with_depth=False)
    state = BundleState.of(bundle.problem)
    found = _Search(state, solver, given, sigma).run()
    if found is None:
        return None
    poses, xyz = _keep_length(bundle.problem.cTw, state.poses, state.points)
    with slam_map.lock:
        for k, cTw in zip(keyframes.tolist(), poses, strict=True):
            slam_map.set_pose(k, cTw)
        pts.xyz[bundle.points] = xyz
        slam_map.refresh(bundle.points[~pts.bad[bundle.points]])
        c = camera.pinhole
        camera.pinhole = replace(c, fx=c.fx * found.factor, fy=c.fy * found.factor)
        camera.baseline /= found.factor
    log.info("Focal length refined by a factor of %.4f (+-%.4f).", found.factor, found.deviation)
    return found


def _keep_length(before: FloatArray, poses: FloatArray, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Scale poses and points about the first camera so that the path is as long as before."""
    old, new = (-np.einsum("nji,nj->ni", P[:, :3, :3], P[:, :3, 3]) for P in (before, poses))
    length = np.linalg.norm(np.diff(new, axis=0), axis=1).sum()
    scale = np.linalg.norm(np.diff(old, axis=0), axis=1).sum() / length if length > 0 else 1.0
    centre = new[0] + scale * (new - new[0])
    poses = poses.copy()
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centre)
    return poses, new[0] + scale * (xyz - new[0])


def self_calibrate(slam_map: Map, camera: CameraModel, solver: BundleSolver, sigma: float) -> dict[str, Any]:
    """Let the map with most keyframes refine the focal length of all; return what was found, for the statistics."""
    kf = slam_map.keyframes
    sizes = np.bincount(kf.map_id[: kf.count][~kf.bad[: kf.count]], minlength=1)
    found = calibrate_focal_length(slam_map, camera, solver, int(np.argmax(sizes)), sigma)
    if found is None:
        return {"refined": False}
    return {"refined": True, "factor": round(found.factor, 5), "deviation": round(found.deviation, 5)}
