"""Local bundle adjustment: Levenberg-Marquardt with Schur complement, compiled and free of the interpreter's lock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ContractError
from prgbd.plugins.slam.orb_gtsam.optimisation.reprojection import split_weights
from prgbd.plugins.slam.orb_gtsam.optimisation.schur import classify, minimise, reject_depths, total_cost

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Relative decrease of the cost at which bundle adjustment has converged.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class BundleResult:
    """Refined poses and points.

    Attributes:
        cTw: (K, 4, 4) float64 poses, world to camera; fixed ones as they came.
        xyz: (P, 3) float64 points in the world; those without a usable observation as they came.
        inlier: (M,) bool, observations with positive depth and a chi-square below 5.991 (monocular) or 7.815 (stereo).
        initial_cost: Half the sum of the (robust, unless switched off) squared errors of all usable observations at
            the start.
        final_cost: The same sum at the end; it can exceed the initial one only by what the observations that were
            removed as outliers cost.
        depth_rejected: (M,) bool, observations that went on without their ``u_right``, because it made outliers of
            pixels that fit; all False unless asked for.
    """

    cTw: FloatArray
    xyz: FloatArray
    inlier: BoolArray
    initial_cost: float
    final_cost: float
    depth_rejected: BoolArray


@dataclass(frozen=True)
class BundleProblem:
    """The columns of a bundle adjustment, contiguous and sorted by point.

    Attributes:
        poses: (K, 4, 4) poses, world to camera; a copy.
        points: (P, 3) points; a copy.
        column: (K,) position of a pose among the free ones, -1 for a fixed one.
        free: Number of free poses.
        order: (M,) the original row of every observation.
        kf: (M,) row of the pose.
        pt: (M,) row of the point, ascending.
        first: (P + 1,) where the observations of each point begin.
        uvr: (M, 3) pixels.
        weight: (M, 2) as from ``split_weights``.
        camera: ``(fx, fy, cx, cy, bf)``.
        usable: (M,) bool, observations that are finite numbers of positive weight.
        depth_rejected: (M,) bool, observations that ``reject_depths`` made monocular.
    """

    poses: FloatArray
    points: FloatArray
    column: IntArray
    free: int
    order: IntArray
    kf: IntArray
    pt: IntArray
    first: IntArray
    uvr: FloatArray
    weight: FloatArray
    camera: FloatArray
    usable: BoolArray
    depth_rejected: BoolArray

    @classmethod
    def build(
        cls,
        cTw: FloatArray,
        fixed: BoolArray,
        xyz: FloatArray,
        obs_kf: IntArray,
        obs_pt: IntArray,
        uvr: FloatArray,
        inv_sigma2: FloatArray,
        camera: tuple[float, float, float, float, float],
    ) -> BundleProblem:
        """Check and sort the columns; see ``local_bundle_adjustment`` for their meaning.

        Raises:
            ContractError: If poses or points are not finite, or an observation names a row that does not exist.
        """
        poses = np.array(cTw, np.float64, order="C")
        points = np.array(xyz, np.float64, order="C").reshape(-1, 3)
        if not (np.isfinite(poses).all() and np.isfinite(points).all()):
            raise ContractError("Bundle adjustment was given poses or points that are not finite; remove them first.")
        order = np.argsort(obs_pt, kind="stable")
        kf, pt = np.ascontiguousarray(obs_kf[order], np.int64), np.ascontiguousarray(obs_pt[order], np.int64)
        if len(kf) and (kf.min() < 0 or kf.max() >= len(poses) or pt[0] < 0 or pt[-1] >= len(points)):
            raise ContractError("Bundle adjustment was given an observation of a keyframe or point that is not there.")
        free = ~np.asarray(fixed, np.bool_)
        sorted_uvr = np.array(uvr[order], np.float64, order="C")
        weight = split_weights(inv_sigma2)[order]
        if not camera[4] > 0:
            sorted_uvr[:, 2] = -1.0
        sorted_uvr[~(weight[:, 1] > 0), 2] = -1.0
        return cls(
            poses=poses,
            points=points,
            column=np.where(free, np.cumsum(free) - 1, -1).astype(np.int64),
            free=int(free.sum()),
            order=order,
            kf=kf,
            pt=pt,
            first=np.searchsorted(pt, np.arange(len(points) + 1)).astype(np.int64),
            uvr=sorted_uvr,
            weight=weight,
            camera=np.array(camera, np.float64),
            usable=np.isfinite(sorted_uvr).all(axis=1) & np.isfinite(weight).all(axis=1) & (weight[:, 0] > 0),
            depth_rejected=np.zeros(len(kf), np.bool_),
        )

    def cost(self, robust: bool) -> float:
        """Return half the sum of (robust) squared errors of the usable observations."""
        return float(
            total_cost(
                self.poses, self.points, self.kf, self.pt, self.uvr, self.weight, self.camera, self.usable, robust
            )
        )

    def inliers(self) -> BoolArray:
        """Return which observations, in sorted order, have positive depth and pass the chi-square test."""
        inlier = np.empty(len(self.kf), np.bool_)
        classify(self.poses, self.points, self.kf, self.pt, self.uvr, self.weight, self.camera, self.usable, inlier)
        return inlier

    def reject_depths(self) -> None:
        """Make monocular the observations that only their depth makes outliers."""
        reject_depths(
            self.poses,
            self.points,
            self.kf,
            self.pt,
            self.uvr,
            self.weight,
            self.camera,
            self.usable,
            self.depth_rejected,
        )

    def minimise(self, active: BoolArray, robust: bool, iterations: int, tolerance: float = TOLERANCE) -> None:
        """Refine poses and points in place on the active observations."""
        minimise(
            self.poses,
            self.points,
            self.column,
            self.free,
            self.kf,
            self.pt,
            self.first,
            self.uvr,
            self.weight,
            self.camera,
            active,
            robust,
            iterations,
            tolerance,
        )

    def result(self, initial_cost: float, robust: bool) -> BundleResult:
        """Return poses and points with the observations' labels in their original order."""
        inlier = np.empty(len(self.kf), np.bool_)
        inlier[self.order] = self.inliers()
        rejected = np.empty(len(self.kf), np.bool_)
        rejected[self.order] = self.depth_rejected
        return BundleResult(self.poses, self.points, inlier, initial_cost, self.cost(robust), rejected)


def local_bundle_adjustment(
    cTw: FloatArray,
    fixed: BoolArray,
    xyz: FloatArray,
    obs_kf: IntArray,
    obs_pt: IntArray,
    uvr: FloatArray,
    inv_sigma2: FloatArray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    bf: float,
    iterations: tuple[int, int] = (5, 10),
    robust: bool = True,
    depth_fallback: bool = False,
    tolerance: float = TOLERANCE,
) -> BundleResult:
    """Refine keyframes and points together, as ORB-SLAM2's ``LocalBundleAdjustment``.

    First with a Huber kernel on all observations, then without it on those that pass the chi-square test and lie in
    front of their camera. With ``robust=False`` both rounds run without kernel and removal.

    Args:
        cTw: (K, 4, 4) poses, world to camera.
        fixed: (K,) bool, poses that hold the others in place. Without any, damping alone holds the map.
        xyz: (P, 3) points in the world.
        obs_kf: (M,) row of the pose of every observation.
        obs_pt: (M,) row of its point.
        uvr: (M, 3) ``(u, v, u_right)`` in pixels; ``u_right < 0`` for monocular observations.
        inv_sigma2: (M,) inverse variance of ``(u, v, u_right)``, or (M, 2) of ``(u, v)`` and of ``u_right``; 1 / px^2.
        fx: Focal length in pixels.
        fy: Focal length in pixels.
        cx: Principal point in pixels.
        cy: Principal point in pixels.
        bf: Baseline times ``fx``; not positive for a monocular camera, whose ``u_right`` are ignored.
        iterations: Most iterations of the two rounds; a round ends earlier when it has converged.
        robust: Whether to apply the kernel and the removal of outliers.
        depth_fallback: Whether observations that only their depth makes outliers go on as monocular ones in the second
            round (needs ``robust``).
        tolerance: Relative decrease of the cost at which a round has converged.

    Returns:
        Refined poses and points, all finite.

    Raises:
        ContractError: If poses or points are not finite, or an observation names a row that does not exist.
    """
    problem = BundleProblem.build(cTw, fixed, xyz, obs_kf, obs_pt, uvr, inv_sigma2, (fx, fy, cx, cy, bf))
    initial_cost = problem.cost(robust)
    problem.minimise(problem.usable, robust, iterations[0], tolerance)
    if robust and depth_fallback:
        problem.reject_depths()
    problem.minimise(problem.inliers() if robust else problem.usable, False, iterations[1], tolerance)
    return problem.result(initial_cost, robust)
