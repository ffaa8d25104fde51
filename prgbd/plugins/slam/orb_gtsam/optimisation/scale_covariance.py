"""How well geometry knows the scale of a map along the way: the covariance that bundle adjustment leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from prgbd.plugins.slam.orb_gtsam.camera.chi_square import CHI2_MONO
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleProblem

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Standard deviation of a normal distribution per median absolute deviation.
_NORMAL = 1.4826
# Inverse variances that fix the first pose, and keep points without parallax and the whole system solvable.
_FIXED, _POINT, _SYSTEM = 1e8, 1e-10, 1e-12
# The second pose that holds the scale of the whole, by as much as it is far from the first: any would do.
_SECOND = 5


@dataclass(frozen=True)
class _Linear:
    """Derivatives of all observations at the map, and what they weigh.

    Attributes:
        pose: (M, 2, 6) by the twist of the keyframe, pixels.
        point: (M, 2, 3) by the point.
        weight: (M,) inverse variance, 1 / px^2.
        depth_pose: (M, 6) derivative of the logarithm of the depth by the twist.
        depth_point: (M, 3) the same by the point.
    """

    pose: FloatArray
    point: FloatArray
    weight: FloatArray
    depth_pose: FloatArray
    depth_point: FloatArray


class ScaleCovariance:
    """Linearises a problem of bundle adjustment by its pixels alone, and tells what is uncertain about its scale.

    The problem's poses must see their points in front of them; measured depth takes no part.

    Attributes:
        depth_variance: (M,) variance of the logarithm of the depth of every observation, all poses given.

    Args:
        problem: Poses, points and observations, pixels with the variance of their pyramid level.
    """

    def __init__(self, problem: BundleProblem) -> None:
        self._poses, self._points = len(problem.cTw), len(problem.xyz)
        self._pose, self._point = problem.pose_row, problem.point_row
        self._linear = _linearise(problem)
        inverse: FloatArray = np.linalg.inv(self._point_information()).astype(np.float64)
        self._point_covariance = _blocks(inverse, np.arange(self._points), np.arange(self._points), self._points)
        by_point = self._linear.depth_point
        self.depth_variance: FloatArray = np.einsum("ni,nij,nj->n", by_point, inverse[self._point], by_point)
        mixed = np.einsum("n,nki,nkj->nij", self._linear.weight, self._linear.pose, self._linear.point)
        self._mixed = _blocks(mixed, self._pose, self._point, self._poses, self._points)
        self._reduced = self._reduced_system(problem.cTw)

    def _point_information(self) -> FloatArray:
        linear = self._linear
        out = np.zeros((self._points, 3, 3))
        np.add.at(out, self._point, np.einsum("n,nki,nkj->nij", linear.weight, linear.point, linear.point))
        return np.asarray(out + np.eye(3) * (_POINT * np.trace(out, axis1=1, axis2=2) + _SYSTEM)[:, None, None])

    def _reduced_system(self, cTw: FloatArray) -> sparse.csc_matrix:
        """Return the information about the poses alone; the first is fixed, and another holds the scale loosely."""
        linear = self._linear
        poses = np.zeros((self._poses, 6, 6))
        np.add.at(poses, self._pose, np.einsum("n,nki,nkj->nij", linear.weight, linear.pose, linear.pose))
        poses[0] += _FIXED * np.eye(6)
        second = min(_SECOND, self._poses - 1)
        apart = np.linalg.norm(np.linalg.inv(cTw[second])[:3, 3] - np.linalg.inv(cTw[0])[:3, 3])
        poses[second, 3:, 3:] += np.eye(3) / max(float(apart), _SYSTEM) ** 2
        full = _blocks(poses, np.arange(self._poses), np.arange(self._poses), self._poses)
        through_points = self._mixed @ self._point_covariance @ self._mixed.T
        return (full - through_points + _SYSTEM * sparse.identity(6 * self._poses)).tocsc()

    def of(self, weight: FloatArray, poses: IntArray) -> FloatArray:
        """Return the covariance of the scale at some poses.

        Args:
            weight: (M,) what every observation counts in the mean log depth of its pose, which is the scale there.
            poses: (N,) rows of poses that have weights.

        Returns:
            (N, N) covariance of the scales' logarithms, as far as pixels that err independently tell; infinite where
            the pixels do not determine the poses.
        """
        share = weight / np.maximum(np.bincount(self._pose, weight, self._poses), _SYSTEM)[self._pose]
        column = np.full(self._poses, -1)
        column[poses] = np.arange(len(poses))
        rows = np.flatnonzero((column[self._pose] >= 0) & (share > 0))
        to, linear = column[self._pose[rows]], self._linear
        by_pose = _blocks(
            (share[:, None] * linear.depth_pose)[rows, :, None], self._pose[rows], to, self._poses, len(poses)
        )
        by_point = _blocks(
            (share[:, None] * linear.depth_point)[rows, :, None], self._point[rows], to, self._points, len(poses)
        )
        spread = self._point_covariance @ by_point
        reduced = (by_pose - self._mixed @ spread).toarray()
        try:
            solved = splu(self._reduced).solve(reduced)
        except RuntimeError:  # SciPy's word for a matrix that is singular
            return np.full((len(poses), len(poses)), np.inf)
        found = reduced.T @ solved + (by_point.T @ spread).toarray()
        return np.asarray(0.5 * (found + found.T))


def _linearise(problem: BundleProblem) -> _Linear:
    fx, fy, cx, cy, _ = problem.camera
    cTw = problem.cTw[problem.pose_row]
    x, y, z = (np.einsum("nij,nj->ni", cTw[:, :3, :3], problem.xyz[problem.point_row]) + cTw[:, :3, 3]).T
    count = len(z)
    pixel = np.zeros((count, 2, 3))
    pixel[:, 0, 0], pixel[:, 0, 2] = fx / z, -fx * x / z**2
    pixel[:, 1, 1], pixel[:, 1, 2] = fy / z, -fy * y / z**2
    twist = np.zeros((count, 3, 6))  # the point moves by omega x p + v
    twist[:, 0, 1], twist[:, 0, 2] = z, -y
    twist[:, 1, 0], twist[:, 1, 2] = -z, x
    twist[:, 2, 0], twist[:, 2, 1] = y, -x
    twist[:, :, 3:] = np.eye(3)
    error = problem.uvr[:, :2] - np.stack([fx * x / z + cx, fy * y / z + cy], axis=1)
    information = problem.inv_sigma2 if problem.inv_sigma2.ndim == 1 else problem.inv_sigma2[:, 0]
    by_depth = np.stack([np.zeros(count), np.zeros(count), 1 / z], axis=1)
    return _Linear(
        pixel @ twist,
        pixel @ cTw[:, :3, :3],
        _robust(error, information),
        np.einsum("ni,nij->nj", by_depth, twist),
        np.einsum("ni,nij->nj", by_depth, cTw[:, :3, :3]),
    )


def _robust(error: FloatArray, information: FloatArray) -> FloatArray:
    """Return Huber's weights; the size of the errors tells the variance of the pixels."""
    scaled = error * np.sqrt(information)[:, None]
    variance = max(float(_NORMAL * np.median(np.abs(scaled))) ** 2, _SYSTEM)
    chi2 = np.maximum((scaled**2).sum(axis=1) / variance, _SYSTEM)
    return np.asarray(information / variance * np.minimum(1.0, np.sqrt(CHI2_MONO / chi2)))


def _blocks(
    blocks: FloatArray, row: IntArray, column: IntArray, rows: int, columns: int | None = None
) -> sparse.csr_matrix:
    """Return a sparse matrix of ``rows`` by ``columns`` blocks (N, a, b) at block rows and columns (N,)."""
    _, a, b = blocks.shape
    i = np.broadcast_to((row[:, None] * a + np.arange(a))[:, :, None], blocks.shape)
    j = np.broadcast_to((column[:, None] * b + np.arange(b))[:, None, :], blocks.shape)
    shape = (rows * a, (rows if columns is None else columns) * b)
    return sparse.csr_matrix((blocks.ravel(), (i.ravel(), j.ravel())), shape=shape)
