"""Frames that COLMAP was not given, or could not register, located against its map by PnP.

The keypoints of registered frames are followed through the frames between them by optical flow, forwards from the frame
before and backwards from the frame behind; what is still followed is seen where its map points are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from prgbd.plugins.slam.colmap.reconstruction import CENTRE, Model, Tell

MIN_POINTS = 20
"""A frame with fewer points, or a pose with fewer inliers, is not located."""
MIN_SHARE = 0.5
"""A pose that fewer of the followed points agree with is none."""
MAX_ERROR = 3.0
"""Pixels of reprojection error of an inlier."""
BACK_AND_FORTH = 1.0
"""Pixels that a point followed to the next frame and back may be off."""
_FLOW = {
    "winSize": (21, 21),
    "maxLevel": 4,
    "criteria": (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.03),
}

Grey = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True)
class Located:
    """Poses of frames that are not in the model.

    Attributes:
        frame_index: (F,) int64, ascending.
        wTc: (F, 4, 4) float64.
        inliers: (F,) int32 map points that agree with the pose.
    """

    frame_index: NDArray[np.int64]
    wTc: NDArray[np.float64]
    inliers: NDArray[np.int32]


@dataclass
class _Followed:
    """Map points (rows of the model's) and the pixels where they are now, (N, 2) float32."""

    point: NDArray[np.int64]
    uv: NDArray[np.float32]


def locate(model: Model, grey: Grey, count: int, seed: int, tell: Tell) -> Located:
    """Locate the frames between, before and behind those of the model, as far as its points can be followed.

    Args:
        model: The model.
        grey: Returns the grey image of a frame.
        count: Number of frames.
        seed: Seed of RANSAC.
        tell: Told of the progress.

    Returns:
        The frames that could be located.
    """
    known = model.frame_index.tolist()
    gaps = [(first + 1, last) for first, last in zip([-1, *known], [*known, count], strict=True) if last > first + 1]
    frames, poses, inliers = [], [], []
    total, done = sum(last - first for first, last in gaps), 0
    for first, last in gaps:
        seen: dict[int, list[_Followed]] = {}
        if first > 0:
            _follow(_points_of(model, first - 1), first - 1, range(first, last), grey, seen)
        if last < count:
            _follow(_points_of(model, last), last, range(last - 1, first - 1, -1), grey, seen)
        for frame in sorted(seen):
            found = _pose(model, seen[frame], seed)
            if found is not None:
                frames.append(frame)
                poses.append(found[0])
                inliers.append(found[1])
        done += last - first
        tell("Locating frames", done, total)
    return Located(
        np.array(frames, np.int64), np.array(poses, np.float64).reshape(-1, 4, 4), np.array(inliers, np.int32)
    )


def _points_of(model: Model, frame: int) -> _Followed:
    """The points that a frame of the model sees."""
    rows = np.flatnonzero(model.keyframe == np.searchsorted(model.frame_index, frame))
    return _Followed(model.point[rows], model.raw_uv[rows])


def _follow(points: _Followed, at: int, frames: Iterable[int], grey: Grey, seen: dict[int, list[_Followed]]) -> None:
    """Follow points from frame ``at`` through ``frames`` and note them in ``seen``, until too few are left."""
    before = grey(at)
    for frame in frames:
        if len(points.point) < MIN_POINTS:
            return
        now = grey(frame)
        moved, there, _ = cv2.calcOpticalFlowPyrLK(before, now, points.uv[:, None], None, **_FLOW)  # type: ignore[call-overload]
        back, again, _ = cv2.calcOpticalFlowPyrLK(now, before, moved, None, **_FLOW)  # type: ignore[call-overload]
        off = np.linalg.norm(back[:, 0] - points.uv, axis=1)
        kept = (there[:, 0] == 1) & (again[:, 0] == 1) & (off < BACK_AND_FORTH)
        points = _Followed(points.point[kept], moved[kept, 0])
        seen.setdefault(frame, []).append(points)
        before = now


def _pose(model: Model, followed: list[_Followed], seed: int) -> tuple[NDArray[np.float64], int] | None:
    """Return ``wTc`` and its number of inliers, or None where too few points agree."""
    point = np.concatenate([f.point for f in followed])
    uv = np.concatenate([f.uv for f in followed]).astype(np.float64) + CENTRE
    if len(point) < MIN_POINTS:
        return None
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error, options.ransac.random_seed = MAX_ERROR, seed
    found = pycolmap.estimate_and_refine_absolute_pose(uv, model.xyz[point], model.lens, options)
    if found is None:
        return None
    agreeing = len(np.unique(point[np.asarray(found["inlier_mask"])]))  # a point may come from before and from behind
    if agreeing < max(MIN_POINTS, MIN_SHARE * len(np.unique(point))):
        return None
    cTw = np.eye(4)
    cTw[:3] = found["cam_from_world"].matrix()
    return np.asarray(np.linalg.inv(cTw), np.float64), agreeing
