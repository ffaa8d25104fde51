"""Geometry of two views: triangulation, and the first map of a monocular camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.geometry.two_view_ambiguity import search_motions
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# ORB-SLAM2's Initializer, with a standard deviation of 1 px: chi-square limits of a point on a line and of a point,
# the share of the homography's score that selects it, and what a reconstruction must reach.
_CHI2_LINE, _CHI2_POINT = 3.841, 5.991
_SELECT_HOMOGRAPHY = 0.40
_REPROJECTION = 4.0
_MIN_POINTS = 50
_MIN_PARALLAX = math.radians(1.0)
# Matches along one line, with less than this standard deviation (pixels) across it, determine no motion.
_MIN_SPREAD = 2.0
# Another motion is a rival if its direction differs by more than this, its cost (as in ``motion_search``) exceeds the
# lowest one by less than this share, and it puts so many points in front of both cameras. In RedKitchen a motion that
# was 117 degrees wrong had the true one as its rival at 1.11 times its cost; in KITTI others cost 2.7 times as much.
_OTHER_DIRECTION = math.radians(40.0)
_RIVAL_COST = 1.25
_RIVAL_IN_FRONT = 0.7
# After a rotation alone as many points come to lie behind the cameras as in front, some more if many are far away.
_LEAST_IN_FRONT = 0.6
# A point seen under a smaller angle is too far to say anything about its depth.
_FAR = 0.99998


@dataclass(frozen=True)
class TwoView:
    """What two views of a monocular camera say about each other.

    Attributes:
        c2Tc1: (4, 4) camera 1 to camera 2; the translation has length 1, as scale is unknown.
        xyz: (N, 3) points in camera 1, in units of the baseline; zero where not ``good``.
        good: (N,) bool, matches that were triangulated well.
        model: ``H`` if a homography explained the matches (a plane), ``F`` if the essential matrix did.
        parallax: Angle in radians that at least 50 points exceed.
    """

    c2Tc1: FloatArray
    xyz: FloatArray
    good: BoolArray
    model: Literal["H", "F"]
    parallax: float


def initialise_two_view(uv1: FloatArray, uv2: FloatArray, K: FloatArray, seed: int = 0) -> TwoView | None:
    """Reconstruct motion and points from matches of two views, as ORB-SLAM2's ``Initializer``.

    A homography and an essential matrix are fitted robustly; their scores choose between them, and the decomposition
    that puts clearly more points in front of both cameras than any other wins.

    Args:
        uv1: (N, 2) undistorted pixels in the first image.
        uv2: (N, 2) their matches in the second.
        K: (3, 3) intrinsic matrix.
        seed: Seed of the random sampling.

    Returns:
        The reconstruction, or None where there are too few matches, too little parallax (such as a pure rotation), no
        clear winner, or another motion that explains the matches about as well.
    """
    first, second = np.ascontiguousarray(uv1, np.float64), np.ascontiguousarray(uv2, np.float64)
    if len(first) < _MIN_POINTS or not (np.isfinite(first).all() and np.isfinite(second).all()):
        return None
    if np.linalg.svd(first - first.mean(0), compute_uv=False)[1] < _MIN_SPREAD * len(first) ** 0.5:
        return None
    H = _usable(cv2.findHomography(first, second, _sampling(seed, _CHI2_POINT**0.5))[0])
    E = _usable(cv2.findEssentialMat(first, second, K, K, None, None, _sampling(seed, _CHI2_LINE**0.5))[0])
    if H is not None and abs(np.linalg.det(H)) < 1e-12:
        H = None
    score_h, inlier_h = (0.0, None) if H is None else _score_homography(H, first, second)
    score_e, inlier_e = (0.0, None) if E is None else _score_essential(E, first, second, K)
    rays1, rays2 = _rays(first, K), _rays(second, K)
    if H is not None and inlier_h is not None and score_h > _SELECT_HOMOGRAPHY * (score_h + score_e):
        _, rotations, translations, _ = cv2.decomposeHomographyMat(H, K)
        motions = [_pose(R, t) for R, t in zip(rotations, translations, strict=True) if np.linalg.norm(t) > 1e-9]
        return _only(_choose(motions, rays1, rays2, K, inlier_h, "H"), first, second, K)
    if E is not None and inlier_e is not None:
        R1, R2, t = cv2.decomposeEssentialMat(E)
        motions = [_pose(R, s * t) for R in (R1, R2) for s in (1.0, -1.0)]
        return _only(_choose(motions, rays1, rays2, K, inlier_e, "F"), first, second, K)
    return None


def _sampling(seed: int, threshold: float) -> Any:
    """Return settings of OpenCV's robust estimators that give the same result every time."""
    parameters = cv2.UsacParams()
    parameters.confidence = 0.999
    parameters.maxIterations = 2000
    parameters.isParallel = False
    parameters.randomGeneratorState = seed
    parameters.sampler = cv2.SAMPLING_UNIFORM
    parameters.score = cv2.SCORE_METHOD_MSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_INNER_AND_ITER_LO
    parameters.loIterations = 10
    parameters.loSampleSize = 50
    parameters.threshold = threshold
    parameters.final_polisher = cv2.LSQ_POLISHER
    parameters.final_polisher_iterations = 3
    return parameters


def _usable(matrix: Any) -> FloatArray | None:
    """Return the matrix as float64, or None where OpenCV found none."""
    found = matrix is not None and matrix.shape == (3, 3) and np.isfinite(matrix).all()
    return np.asarray(matrix, np.float64) if found else None


def _rays(uv: FloatArray, K: FloatArray) -> FloatArray:
    return np.asarray((uv - K[:2, 2]) / [K[0, 0], K[1, 1]])


def _pose(rotation: NDArray[Any], translation: NDArray[Any]) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = np.ravel(translation) / np.linalg.norm(translation)
    return pose


def _score_homography(H: FloatArray, uv1: FloatArray, uv2: FloatArray) -> tuple[float, BoolArray]:
    """Return the sum over both directions of what the chi-squares leave below the limit, and the inliers of both."""
    score, inlier = 0.0, np.ones(len(uv1), np.bool_)
    for M, a, b in ((H, uv1, uv2), (np.linalg.inv(H), uv2, uv1)):
        p = a @ M[:, :2].T + M[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            chi2 = np.sum((p[:, :2] / p[:, 2:] - b) ** 2, axis=1)
        below = chi2 <= _CHI2_POINT
        score += float(np.sum(_CHI2_POINT - chi2[below]))
        inlier &= below
    return score, inlier


def _score_essential(E: FloatArray, uv1: FloatArray, uv2: FloatArray, K: FloatArray) -> tuple[float, BoolArray]:
    """Return the same for the distances from the epipolar lines, scored against the limit of a point."""
    to_rays = np.linalg.inv(K)
    F = to_rays.T @ E @ to_rays
    score, inlier = 0.0, np.ones(len(uv1), np.bool_)
    for M, a, b in ((F, uv1, uv2), (F.T, uv2, uv1)):
        line = a @ M[:, :2].T + M[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            chi2 = (np.sum(line[:, :2] * b, axis=1) + line[:, 2]) ** 2 / np.sum(line[:, :2] ** 2, axis=1)
        below = chi2 <= _CHI2_LINE
        score += float(np.sum(_CHI2_POINT - chi2[below]))
        inlier &= below
    return score, inlier


def _choose(
    motions: list[FloatArray],
    rays1: FloatArray,
    rays2: FloatArray,
    K: FloatArray,
    inlier: BoolArray,
    model: Literal["H", "F"],
) -> TwoView | None:
    """Return the motion that reconstructs clearly more points than the others, if it is good enough."""
    if not motions:
        return None
    found = [_reconstruct(c2Tc1, rays1, rays2, K, inlier, far_behind=model == "F") for c2Tc1 in motions]
    counts = np.array([count for _, _, count, _ in found])
    best = int(np.argmax(counts))
    rivals = np.delete(counts, best)
    clear = not len(rivals) or rivals.max() < (0.75 if model == "H" else 0.7) * counts[best]
    xyz, good, count, parallax = found[best]
    enough = count >= max(_MIN_POINTS, 0.9 * inlier.sum()) and good.sum() >= _MIN_POINTS
    if not (clear and enough and parallax > _MIN_PARALLAX):
        return None
    return TwoView(motions[best], np.where(good[:, None], xyz, 0.0), good, model, parallax)


def _only(found: TwoView | None, uv1: FloatArray, uv2: FloatArray, K: FloatArray) -> TwoView | None:
    """Return the reconstruction with the motion that explains all matches best; None if another explains them as well.

    RANSAC ends near one minimum of the error, not always the lowest, and the lowest is not always the true one. A map
    that begins with a wrong motion stays wrong, though every frame of it may be tracked.
    """
    if found is None:
        return None
    rays1, rays2 = _rays(uv1, K), _rays(uv2, K)
    nearest, *others = search_motions(found.c2Tc1, rays1, rays2, (float(K[0, 0]), float(K[1, 1])))
    if nearest.in_front < _LEAST_IN_FRONT:
        return None
    best = nearest
    for motion in others:
        other = motion.direction_from(nearest) > _OTHER_DIRECTION
        if other and motion.in_front >= _RIVAL_IN_FRONT and motion.cost < _RIVAL_COST * nearest.cost:
            return None
        if not other and motion.in_front >= nearest.in_front - 0.05 and motion.cost < best.cost:
            best = motion
    if found.model == "H":
        return found
    t, R = best.c2Tc1[:3, 3], best.c2Tc1[:3, :3]
    E = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]]) @ R
    return _choose([best.c2Tc1], rays1, rays2, K, _score_essential(E, uv1, uv2, K)[1], "F") or found


def _reconstruct(
    c2Tc1: FloatArray, rays1: FloatArray, rays2: FloatArray, K: FloatArray, inlier: BoolArray, *, far_behind: bool
) -> tuple[FloatArray, BoolArray, int, float]:
    """Triangulate with one hypothesis.

    With ``far_behind``, far points agree even if they came to lie behind a camera, as noise may put them there. On a
    plane that would hide what tells its two remaining hypotheses apart.

    Returns:
        Points (N, 3); which are good (N,); how many agree with the hypothesis, among them those too far to be good;
        the parallax in radians that 50 points exceed.
    """
    xyz = triangulate_pairs(np.eye(4), c2Tc1, rays1, rays2)
    with np.errstate(divide="ignore", invalid="ignore"):
        in2 = xyz @ c2Tc1[:3, :3].T + c2Tc1[:3, 3]
        from2 = xyz + c2Tc1[:3, :3].T @ c2Tc1[:3, 3]
        cosine = np.sum(xyz * from2, axis=1) / (np.linalg.norm(xyz, axis=1) * np.linalg.norm(from2, axis=1))
        far = cosine >= _FAR
        agrees = inlier & np.isfinite(xyz).all(axis=1)
        focal = np.array([K[0, 0], K[1, 1]])
        for points, rays in ((xyz, rays1), (in2, rays2)):
            error = np.sum(((points[:, :2] / points[:, 2:] - rays) * focal) ** 2, axis=1)
            agrees &= ((points[:, 2] > 0) | (far & far_behind)) & (error <= _REPROJECTION)
    if not agrees.any():
        return xyz, agrees, 0, 0.0
    ascending = np.sort(cosine[agrees])
    parallax = math.acos(float(np.clip(ascending[min(_MIN_POINTS, len(ascending)) - 1], -1.0, 1.0)))
    return xyz, agrees & ~far & (xyz[:, 2] > 0), int(agrees.sum()), parallax


def triangulate_pairs(c1Tw: FloatArray, c2Tw: FloatArray, rays1: FloatArray, rays2: FloatArray) -> FloatArray:
    """Triangulate points from two views, each with the least reprojection error in the normalised images.

    Every pair of rays is first moved onto each other's epipolar lines (Lindstrom, "Triangulation made easy",
    CVPR 2010, two iterations), then intersected.

    Args:
        c1Tw: (4, 4) first pose, world to camera.
        c2Tw: (4, 4) second pose.
        rays1: (N, 2) normalised image coordinates ``(x/z, y/z)`` in the first view.
        rays2: (N, 2) in the second.

    Returns:
        (N, 3) points in the world. A row is NaN where the rays are parallel, and lies behind a camera where they meet
        there: both fail a check of depth and reprojection.
    """
    c2Tc1 = np.asarray(c2Tw, np.float64) @ inverse(np.asarray(c1Tw, np.float64))
    points = np.empty((len(rays1), 3))
    triangulate_into(c2Tc1, np.ascontiguousarray(rays1, np.float64), np.ascontiguousarray(rays2, np.float64), points)
    wTc1 = inverse(np.asarray(c1Tw, np.float64))
    return points @ wTc1[:3, :3].T + wTc1[:3, 3]


@kernel()
def triangulate_into(c2Tc1: FloatArray, rays1: FloatArray, rays2: FloatArray, points: FloatArray) -> None:
    """Fill ``points`` in coordinates of camera 1."""
    E = np.empty((3, 3))
    t0, t1, t2 = c2Tc1[0, 3], c2Tc1[1, 3], c2Tc1[2, 3]
    for j in range(3):
        r0, r1, r2 = c2Tc1[0, j], c2Tc1[1, j], c2Tc1[2, j]
        E[0, j] = t1 * r2 - t2 * r1
        E[1, j] = t2 * r0 - t0 * r2
        E[2, j] = t0 * r1 - t1 * r0
    for k in range(len(rays1)):
        x1, y1, x2, y2 = _onto_epipolar_lines(E, rays1[k, 0], rays1[k, 1], rays2[k, 0], rays2[k, 1])
        # depth * (x1, y1, 1) rotated, plus t, is parallel to (x2, y2, 1).
        a0 = c2Tc1[0, 0] * x1 + c2Tc1[0, 1] * y1 + c2Tc1[0, 2]
        a1 = c2Tc1[1, 0] * x1 + c2Tc1[1, 1] * y1 + c2Tc1[1, 2]
        a2 = c2Tc1[2, 0] * x1 + c2Tc1[2, 1] * y1 + c2Tc1[2, 2]
        c0, c1, c2 = y2 * a2 - a1, a0 - x2 * a2, x2 * a1 - y2 * a0
        d0, d1, d2 = y2 * t2 - t1, t0 - x2 * t2, x2 * t1 - y2 * t0
        square = c0 * c0 + c1 * c1 + c2 * c2
        depth = -(c0 * d0 + c1 * d1 + c2 * d2) / square if square > 1e-20 else math.nan
        points[k, 0], points[k, 1], points[k, 2] = depth * x1, depth * y1, depth


@kernel()
def _onto_epipolar_lines(
    E: FloatArray, x1: float, y1: float, x2: float, y2: float
) -> tuple[float, float, float, float]:
    """Return the nearest rays that fulfil ``r2' E r1 = 0``."""
    # n1 = S E r1 lies across the line in image 2, n2 = S E' r2 across the line in image 1.
    n1x = E[0, 0] * x1 + E[0, 1] * y1 + E[0, 2]
    n1y = E[1, 0] * x1 + E[1, 1] * y1 + E[1, 2]
    n2x = E[0, 0] * x2 + E[1, 0] * y2 + E[2, 0]
    n2y = E[0, 1] * x2 + E[1, 1] * y2 + E[2, 1]
    c = x2 * n1x + y2 * n1y + E[2, 0] * x1 + E[2, 1] * y1 + E[2, 2]
    a = n2x * (E[0, 0] * n1x + E[1, 0] * n1y) + n2y * (E[0, 1] * n1x + E[1, 1] * n1y)
    b = 0.5 * (n1x * n1x + n1y * n1y + n2x * n2x + n2y * n2y)
    d = b * b - a * c
    if not (d >= 0.0 and b > 0.0):
        return x1, y1, x2, y2
    step = c / (b + math.sqrt(d))
    dx1, dy1, dx2, dy2 = step * n2x, step * n2y, step * n1x, step * n1y
    m1x, m1y = n1x - (E[0, 0] * dx1 + E[0, 1] * dy1), n1y - (E[1, 0] * dx1 + E[1, 1] * dy1)
    m2x, m2y = n2x - (E[0, 0] * dx2 + E[1, 0] * dy2), n2y - (E[0, 1] * dx2 + E[1, 1] * dy2)
    square1, square2 = m1x * m1x + m1y * m1y, m2x * m2x + m2y * m2y
    if square1 == 0.0 or square2 == 0.0:
        return x1, y1, x2, y2
    along1 = (dx2 * m1x + dy2 * m1y) / square1
    along2 = (dx1 * m2x + dy1 * m2y) / square2
    return x1 - along2 * m2x, y1 - along2 * m2y, x2 - along1 * m1x, y2 - along1 * m1y
