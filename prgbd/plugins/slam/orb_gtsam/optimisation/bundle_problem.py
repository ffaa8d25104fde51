"""What bundle adjustment refines: poses and points, by the pixels at which the cameras saw the points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ContractError
from prgbd.plugins.slam.orb_gtsam.optimisation.reprojection import split_weights
from prgbd.plugins.slam.orb_gtsam.optimisation.schur import classify, reject_depths, total_cost

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class BundleProblem:
    """Poses, points and observations as they are given; solvers work on copies.

    Attributes:
        cTw: (K, 4, 4) poses, world to camera.
        fixed: (K,) bool, poses that hold the others in place. Without any, damping alone holds the map.
        xyz: (P, 3) points in the world.
        pose_row: (M,) row of the pose of every observation.
        point_row: (M,) row of its point.
        uvr: (M, 3) ``(u, v, u_right)`` in pixels; ``u_right < 0`` for monocular observations.
        inv_sigma2: (M,) inverse variance of ``(u, v, u_right)``, or (M, 2) of ``(u, v)`` and of ``u_right``; 1 / px^2.
        camera: ``(fx, fy, cx, cy, bf)`` in pixels; ``bf`` (baseline times ``fx``) is not positive for a monocular
            camera, whose ``u_right`` are ignored.

    Raises:
        ContractError: If poses or points are not finite, or an observation names a row that does not exist.
    """

    cTw: FloatArray
    fixed: BoolArray
    xyz: FloatArray
    pose_row: IntArray
    point_row: IntArray
    uvr: FloatArray
    inv_sigma2: FloatArray
    camera: tuple[float, float, float, float, float]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.cTw).all() and np.isfinite(self.xyz).all()):
            raise ContractError("Bundle adjustment was given poses or points that are not finite; remove them first.")
        for rows, count in ((self.pose_row, len(self.cTw)), (self.point_row, len(self.xyz))):
            if len(rows) and (rows.min() < 0 or rows.max() >= count):
                raise ContractError(
                    "Bundle adjustment was given an observation of a keyframe or point that is not there."
                )


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
class BundleState:
    """A problem while it is being solved: columns of its own, contiguous and sorted by point.

    Attributes:
        poses: (K, 4, 4) poses, world to camera.
        points: (P, 3) points.
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
    def of(cls, problem: BundleProblem) -> BundleState:
        """Copy and sort the columns of a problem."""
        points = np.array(problem.xyz, np.float64, order="C").reshape(-1, 3)
        order = np.argsort(problem.point_row, kind="stable")
        pt = np.ascontiguousarray(problem.point_row[order], np.int64)
        free = ~np.asarray(problem.fixed, np.bool_)
        uvr = np.array(problem.uvr[order], np.float64, order="C")
        weight = split_weights(problem.inv_sigma2)[order]
        if not problem.camera[4] > 0:
            uvr[:, 2] = -1.0
        uvr[~(weight[:, 1] > 0), 2] = -1.0
        return cls(
            poses=np.array(problem.cTw, np.float64, order="C"),
            points=points,
            column=np.where(free, np.cumsum(free) - 1, -1).astype(np.int64),
            free=int(free.sum()),
            order=order,
            kf=np.ascontiguousarray(problem.pose_row[order], np.int64),
            pt=pt,
            first=np.searchsorted(pt, np.arange(len(points) + 1)).astype(np.int64),
            uvr=uvr,
            weight=weight,
            camera=np.array(problem.camera, np.float64),
            usable=np.isfinite(uvr).all(axis=1) & np.isfinite(weight).all(axis=1) & (weight[:, 0] > 0),
            depth_rejected=np.zeros(len(pt), np.bool_),
        )

    @property
    def _residuals(self) -> tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
        """The columns that tell the error of every observation, as the compiled functions take them."""
        return self.poses, self.points, self.kf, self.pt, self.uvr, self.weight, self.camera

    def cost(self, robust: bool) -> float:
        """Return half the sum of (robust) squared errors of the usable observations."""
        return float(total_cost(*self._residuals, self.usable, robust))

    def inliers(self) -> BoolArray:
        """Return which observations, in sorted order, have positive depth and pass the chi-square test."""
        inlier = np.empty(len(self.kf), np.bool_)
        classify(*self._residuals, self.usable, inlier)
        return inlier

    def reject_depths(self) -> None:
        """Make monocular the observations that only their depth makes outliers."""
        reject_depths(*self._residuals, self.usable, self.depth_rejected)

    def result(self, initial_cost: float, robust: bool) -> BundleResult:
        """Return poses and points with the observations' labels in their original order."""
        inlier, rejected = np.empty(len(self.kf), np.bool_), np.empty(len(self.kf), np.bool_)
        inlier[self.order] = self.inliers()
        rejected[self.order] = self.depth_rejected
        return BundleResult(self.poses, self.points, inlier, initial_cost, self.cost(robust), rejected)
