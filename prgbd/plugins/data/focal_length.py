"""The focal length by which pairs of images fit best: what a turning camera says of its calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from prgbd.core.types import PinholeCamera
from prgbd.plugins.data.image_motion import followed, small

WIDTH = 640
"""Pixels that images are shrunk to, where they are wider; pixels of this module are those of shrunk images."""

FACTORS = np.exp(np.linspace(np.log(0.62), np.log(1 / 0.62), 9))
"""What the given focal length is multiplied with; the middle one is 1."""

MOST_PAIRS = 6
LEAST_TURN = 1.0  # degrees between the images of a pair; less says nothing

_CORNERS, _APART = 200, 12  # of an image; pixels between two
_FAR = 80.0  # pixels of motion between the images of a pair, at most _FRAMES apart
_FRAMES = 10
_STRIDE, _LONGEST_STRIDE = 20.0, 3  # pixels and frames from one image to the next that corners are followed through
_CAME_BACK = 0.3  # pixels from where it began, of a corner that is followed forth and back
_FEWEST = 30  # corners of a pair
_NOISE = 0.12  # pixels that followed corners are off
_STARTS = (1, 4, 7)  # of the factors, at which a motion is sought anew
_STEPS = 12  # of an optimisation

Vectors = NDArray[np.float64]
Pair = tuple[Vectors, Vectors]


@dataclass(frozen=True)
class FocalFit:
    """How well pairs of images fit with other focal lengths.

    Attributes:
        factor: What the given focal length is to be multiplied with to fit best.
        gain: How much better it fits than the given one, in squares of the noise.
        agreement: From -1 to 1, whether all pairs say so (1) or others contradict as loudly (0).
    """

    factor: float
    gain: float
    agreement: float


def tracked_pair(image: Callable[[int], NDArray[np.uint8]], start: int, count: int) -> Pair | None:
    """Follow corners from a frame through the next ones, until the picture has moved far.

    Args:
        image: Returns a frame, (H, W, 3) uint8 RGB.
        start: The first of the frames.
        count: How many frames there are.

    Returns:
        Where the corners are in the first and in the last image, (N, 2) each, or None where too few can be followed.
    """
    before = _shrunk(image(start))
    pair = followed(before, _shrunk(image(start + 1))) if start + 1 < count else None
    begin = cv2.goodFeaturesToTrack(before, _CORNERS, 0.01, _APART)
    if pair is None or begin is None:
        return None
    motion = float(np.median(np.linalg.norm(pair[1] - pair[0], axis=1)))
    stride = int(np.clip(round(_STRIDE / max(motion, 1e-3)), 1, _LONGEST_STRIDE))
    now, alive = begin, np.ones(len(begin), bool)
    for index in range(start + stride, min(start + _FRAMES + 1, count), stride):
        picture = _shrunk(image(index))
        moved, seen, _ = cv2.calcOpticalFlowPyrLK(before, picture, now, None)  # type: ignore[call-overload]
        back, again, _ = cv2.calcOpticalFlowPyrLK(picture, before, moved, None)  # type: ignore[call-overload]
        still = alive & (seen.ravel() == 1) & (again.ravel() == 1)
        still &= np.linalg.norm((back - now)[:, 0], axis=1) < _CAME_BACK
        if still.sum() < _FEWEST:
            break
        before, now, alive = picture, moved, still
        if np.median(np.linalg.norm((now - begin)[alive, 0], axis=1)) > _FAR:
            break
    return begin[alive, 0].astype(np.float64), now[alive, 0].astype(np.float64)


def fit_focal_length(pairs: Sequence[Pair], camera: PinholeCamera) -> FocalFit | None:
    """Fit the motion between the images of those pairs that turn most, with several focal lengths.

    Args:
        pairs: As ``tracked_pair`` returns them.
        camera: The camera of the images as they were.

    Returns:
        The focal length that fits best, or None where none in between does.
    """
    width = min(WIDTH, camera.width)
    shrunk = camera.resized(width, round(camera.height * width / camera.width))
    f, centre = shrunk.fx, np.array([shrunk.cx, shrunk.cy])
    stretch = np.array([1.0, shrunk.fx / shrunk.fy])
    rays = [((a - centre) * stretch, (b - centre) * stretch) for a, b in pairs]
    turns = [0.0 if (motion := _motion(a, b, f)) is None else np.degrees(np.linalg.norm(motion[:3])) for a, b in rays]
    chosen = [i for i in np.argsort(turns)[::-1][:MOST_PAIRS] if turns[i] > LEAST_TURN]
    if not chosen:
        return None
    costs = np.array([_costs(rays[i][0], rays[i][1], f) for i in chosen])
    together = costs.sum(axis=0)
    lowest = int(together.argmin())
    if not 0 < lowest < len(FACTORS) - 1:
        return None
    left, middle, right = together[lowest - 1 : lowest + 2]
    shift = 0.5 * (left - right) / max(left - 2 * middle + right, 1e-9)  # of a parabola through the three
    gains = costs[:, len(FACTORS) // 2] - costs[:, lowest]
    factor = FACTORS[lowest] * (FACTORS[1] / FACTORS[0]) ** shift
    return FocalFit(float(factor), float(gains.sum()), float(gains.sum() / max(np.abs(gains).sum(), 1e-9)))


def _shrunk(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return small(image, min(WIDTH, image.shape[1]))


def _costs(a: Vectors, b: Vectors, f: float) -> Vectors:
    """The robust cost of the best motion with every factor; what is found with one is the start of its neighbours."""
    best = np.full(len(FACTORS), np.inf)
    motions: list[Vectors | None] = [None] * len(FACTORS)

    def improve(i: int, start: Vectors) -> None:
        given = (a, b, f * FACTORS[i])
        found = least_squares(_off, start, args=given, loss="cauchy", f_scale=_NOISE, max_nfev=_STEPS)
        if found.cost < best[i]:
            best[i], motions[i] = found.cost, found.x

    for i in _STARTS:
        start = _motion(a, b, f * FACTORS[i])
        if start is not None:
            improve(i, start)
    forth = range(len(FACTORS))
    for order in (forth, reversed(forth), forth):
        for before, i in pairwise(order):
            start = motions[before]
            if start is not None:
                improve(i, start)
    return 2 * best / _NOISE**2


def _motion(a: Vectors, b: Vectors, f: float) -> Vectors | None:
    """The motion that most corners agree on: a rotation vector and the direction of a translation, (6,)."""
    K = np.diag([f, f, 1.0])
    essential, _ = cv2.findEssentialMat(a, b, K, cv2.RANSAC, 0.99, 1.0)
    if essential is None or essential.shape != (3, 3):
        return None
    _, R, t, _ = cv2.recoverPose(essential, a, b, K)
    return np.r_[Rotation.from_matrix(R).as_rotvec(), t.ravel()]


def _off(motion: Vectors, a: Vectors, b: Vectors, f: float) -> Vectors:
    """Sampson's distance of corners from where the motion allows them, pixels."""
    R = Rotation.from_rotvec(motion[:3]).as_matrix()
    x, y, z = motion[3:] / np.linalg.norm(motion[3:])
    E = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ R
    Ea = a @ (E[:, :2].T / f) + E[:, 2]
    Eb = b @ (E[:2] / f) + E[2]
    above = (b[:, 0] * Ea[:, 0] + b[:, 1] * Ea[:, 1]) / f + Ea[:, 2]
    return np.asarray(f * above / np.sqrt(Ea[:, 0] ** 2 + Ea[:, 1] ** 2 + Eb[:, 0] ** 2 + Eb[:, 1] ** 2 + 1e-12))
