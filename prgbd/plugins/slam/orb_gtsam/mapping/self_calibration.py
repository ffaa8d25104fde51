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
# First trial steps of relative focal length and radial distortion, the change at which the search ends, and its most
# bundle adjustments.
_STEPS = np.array([0.01, 0.005])
_PRECISION = 5e-4
_ROUNDS = 5
# The focal length stays within this many standard deviations of the given one.
_TRUST = 4.0
# By how much the errors that all keypoints share (slanted patches, borders, rolling shutter) outweigh what pixels that
# err independently would let one know: along the valley in which focal length and distortion make up for each other
# the given camera decides. With 1 a map of 70 keyframes of KITTI 00 ran along it; with 5 it finds the same as mono's.
_OVERCONFIDENCE = 5.0
# A map must know the focal length this many times better than the user, or it says too little: errors that all
# keypoints share (matches of repeated texture, rolling shutter) would decide.
_BETTER = 4.0
# It must contradict the user by this many standard deviations: on made-up worlds, whose camera is known, such maps were
# wrong by up to 0.9 %, so what differs by less is left alone. Distortion must be this many from none.
_CONTRADICTS, _DISTORTED = 1.5, 2.5
# Standard deviation of the radial distortion that is left in images that are said to have none: rectified recordings
# are off by some pixels at the borders (KITTI: Cvisic et al., "Recalibrating the KITTI Dataset Camera Setup for
# Improved Odometry Accuracy", 2021).
_RADIAL_SIGMA = 0.005
# A map of fewer keyframes is not asked.
_LEAST_KEYFRAMES = 10


@dataclass(frozen=True)
class FocalLength:
    """What a map says about the focal length.

    Attributes:
        factor: Best focal length over that before.
        deviation: Its standard deviation, from the curvature of the cost and the spread of the errors.
        rounds: Bundle adjustments that it took.
        radial: Radial distortion that the images still had: keypoints at r focal lengths from the principal point were
            moved outwards by ``radial * r^3``.
    """

    factor: float
    deviation: float
    rounds: int
    radial: float = 0.0


class _Search:
    """Bundle adjustments of one map with different cameras, each from the result of the last.

    A camera is two numbers: its focal length over the present one, and the radial distortion that the images still
    have, by which a pixel at r (in focal lengths) from the principal point moves outwards by ``radial * r^2`` of r.
    """

    def __init__(self, state: BundleState, solver: BundleSolver, given: float, sigma: float) -> None:
        self.state, self.solver = state, solver
        self.likely, self.sigmas = np.array([given, 0.0]), np.array([sigma, _RADIAL_SIGMA])
        self.focal = state.camera[:2].copy()
        self.rounds = 0
        self._pixels = state.uvr[:, :2].copy()
        self._off_centre = self._pixels - state.camera[2:4]
        self._square = ((self._off_centre / self.focal) ** 2).sum(axis=1)
        # Variance of the errors over the assumed one; keypoints are placed better than a pixel, so it is below 1.
        self._excess, self._overconfidence = 1.0, 1.0

    def gradient(self, lens: FloatArray) -> FloatArray:
        """Adjust the map with this camera and return the derivatives (2,) of the least cost by its two numbers.

        At the minimum over poses and points their derivatives vanish, so that those of the camera alone are left.
        """
        state = self.state
        self.rounds += 1
        state.camera[:2] = self.focal * lens[0]
        state.uvr[:, :2] = self._pixels + lens[1] * self._square[:, None] * self._off_centre
        self.solver.minimise(state, state.usable, robust=True, iterations=_ITERATIONS, tolerance=_TOLERANCE)
        pose = state.poses[state.kf]
        p = np.einsum("nij,nj->ni", pose[:, :3, :3], state.points[state.pt]) + pose[:, :3, 3]
        seen = state.usable & (p[:, 2] > 1e-9)
        ray = p[seen, :2] / p[seen, 2:] * self.focal
        error = state.uvr[seen, :2] - (ray * lens[0] + state.camera[2:4])
        weight = state.weight[seen, 0]
        chi2 = np.maximum(weight * (error**2).sum(axis=1), 1e-12)
        weight = weight * np.minimum(1.0, np.sqrt(CHI2_MONO / chi2))
        moves = self._square[seen, None] * self._off_centre[seen]
        data = np.array([-(weight * (error * ray).sum(axis=1)).sum(), (weight * (error * moves).sum(axis=1)).sum()])
        if self.rounds == 1:
            self._excess = float((weight * (error**2).sum(axis=1)).sum()) / self._freedom()
        return np.asarray(data / (self._overconfidence**2 * self._excess) + (lens - self.likely) / self.sigmas**2)

    def _freedom(self) -> int:
        """Return the degrees of freedom: two a keypoint, less three a point and six a pose."""
        state = self.state
        seen = int(np.count_nonzero(np.diff(state.first)))
        return max(2 * int(state.usable.sum()) - 3 * seen - 6 * state.free, 1)

    def run(self) -> FocalLength | None:
        """Look for distortion beside a focal length that stays, then for the focal length alone; None without reason.

        Where both would have to change, they mostly make up for each other: on made-up worlds, which have neither, maps
        were wrong by up to 1.6 % and -.014 together.
        """
        self._overconfidence = _OVERCONFIDENCE
        both = self._minimum([0, 1])
        if both is not None and self._known(both[1], _OVERCONFIDENCE):
            off = np.abs(both[0] - self.likely) / self.sigmas
            if off[0] < 1.0 and off[1] > _DISTORTED:
                return self._found(*both)
        self._overconfidence = 1.0
        alone = self._minimum([0])
        if alone is None or not self._known(alone[1], 1.0):
            return None
        return self._found(*alone) if abs(alone[0][0] - self.likely[0]) > _CONTRADICTS * self.sigmas[0] else None

    def _known(self, curvature: FloatArray, overconfidence: float) -> bool:
        return bool(overconfidence * np.sqrt(curvature[0, 0]) > _BETTER / self.sigmas[0])

    def _found(self, lens: FloatArray, curvature: FloatArray) -> FocalLength:
        self.gradient(lens)
        deviation = float(np.sqrt(np.linalg.inv(curvature)[0, 0]))
        return FocalLength(float(lens[0]), deviation, self.rounds, float(lens[1]))

    def _minimum(self, free: list[int]) -> tuple[FloatArray, FloatArray] | None:
        """Find where the gradient vanishes, by a secant method (Broyden's).

        Args:
            free: Which of the two numbers may change.

        Returns:
            The camera (2,) and the curvature (F, F), or None where there is no minimum.
        """
        lens, most = np.array([1.0, 0.0]), self.rounds + _ROUNDS + 2 * (len(free) - 1)
        slope = self.gradient(lens)
        low, high = self.likely - _TRUST * self.sigmas, self.likely + _TRUST * self.sigmas
        curvature = np.zeros((len(free), len(free)))
        for column, i in enumerate(free):
            trial = lens.copy()
            trial[i] -= np.sign(slope[i]) * _STEPS[i]
            curvature[:, column] = (self.gradient(trial) - slope)[free] / (trial[i] - lens[i])
        curvature = 0.5 * (curvature + curvature.T)
        while np.linalg.eigvalsh(0.5 * (curvature + curvature.T))[0] > 0:
            trial, step = lens.copy(), np.linalg.solve(curvature, slope[free])
            trial[free] -= step / max(1.0, np.max(np.abs(step) / (2 * _STEPS[free])))
            trial = np.clip(trial, low, high)
            step = (trial - lens)[free]
            if np.all(np.abs(step) <= _PRECISION) or self.rounds >= most:
                return lens, 0.5 * (curvature + curvature.T)
            found = self.gradient(trial)
            curvature += np.outer((found - slope)[free] - curvature @ step, step) / (step @ step)
            lens, slope = trial, found
        return None


def calibrate_focal_length(
    slam_map: Map, camera: CameraModel, solver: BundleSolver, map_id: int, sigma: float, given: float = 1.0
) -> FocalLength | None:
    """Refine the focal length together with poses and points of a map, by its pixels alone, and give it to ``camera``.

    Small errors of calibration and rectification look like a wrong focal length. They bend the trajectory in turns and
    change its scale there, far above the noise of the keypoints. A turn, or parallax in several directions, tells the
    focal length; where the motion does not (straight ahead), or where the given one fits, nothing changes.

    Together with the focal length it finds the radial distortion that is left in the images and takes it out of the
    keypoints; fx and fy keep their ratio. The length of the path stays, so that poses relative to keyframes stay valid.
    ORB-SLAM2 has no such step.

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
        _straighten(slam_map, camera, found.radial)
        camera.pinhole = replace(c, fx=c.fx * found.factor, fy=c.fy * found.factor)
        camera.baseline /= found.factor
    log.info(
        "Focal length refined by a factor of %.4f (+-%.4f), radial distortion %.4f.",
        found.factor,
        found.deviation,
        found.radial,
    )
    return found


def _straighten(slam_map: Map, camera: CameraModel, radial: float) -> None:
    """Take a radial distortion out of the keypoints of all keyframes; their right columns follow."""
    kf = slam_map.keyframes
    n = kf.count
    x = camera.rays(kf.uv[:n].reshape(-1, 2)).reshape(n, -1, 2)
    off = (radial * (x**2).sum(axis=2, keepdims=True) * x * (camera.pinhole.fx, camera.pinhole.fy)).astype(np.float32)
    kf.uv[:n] += off
    kf.u_right[:n] = np.where(kf.u_right[:n] >= 0, kf.u_right[:n] + off[..., 0], kf.u_right[:n])


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
    return {
        "refined": True,
        "factor": round(found.factor, 5),
        "deviation": round(found.deviation, 5),
        "radial": round(found.radial, 5),
    }
