"""When a frame becomes a keyframe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.settings import KeyframeOptions
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame

# ORB-SLAM2 (Tracking::NeedNewKeyFrame): below this share of the reference keyframe tracking is weak.
_WEAK_SHARE = 0.25
# The same: a keyframe has more inliers than this; close points are needed where more than this many could be created.
MIN_INLIERS, CLOSE_UNTRACKED = 15, 70


def needs_keyframe(
    slam_map: Map,
    camera: CameraModel,
    options: KeyframeOptions,
    frame: TrackedFrame,
    inliers: int,
    reference: int,
    since_last: int,
    fps: float,
    doubtful: NDArray[np.bool_] | None = None,
    held_share: float = 0.0,
) -> bool:
    """Decide as ORB-SLAM2 does (Tracking::NeedNewKeyFrame) with a mapper that is always idle.

    Args:
        slam_map: The map.
        camera: The camera.
        options: Thresholds.
        frame: The tracked frame.
        inliers: Its inliers.
        reference: The keyframe that shares most points with it.
        since_last: Frames since the last keyframe.
        fps: Frame rate.
        doubtful: (N,) bool keypoints of the reference keyframe whose points are not to be expected: a keyframe gets
            its frame's outliers along, and bundle adjustment may not have seen it yet.
        held_share: A frame with fewer inliers than this share of all points of the reference keyframe becomes one.
    """
    keyframes = len(slam_map.alive())
    least = 3 if keyframes > 2 else 2
    points = slam_map.points_of(reference)
    counts = slam_map.observation_counts(points, double=not camera.mono)
    known = counts >= least
    expected = int(np.count_nonzero(known if doubtful is None else known & ~doubtful))
    needs_close = not camera.mono and _needs_close_points(camera, options.close_tracked, frame)
    later = options.ratio if camera.noise.is_zero else options.ratio_pseudo
    ratio = options.ratio_first if keyframes < 2 else later
    if camera.without_unit:
        ratio = options.ratio_mono
    overdue = since_last >= fps
    mapper_is_ready = since_last >= options.min_interval
    weak = not camera.mono and (inliers < _WEAK_SHARE * expected or needs_close)
    # A map that grows too slowly for the motion has few points that three keyframes see, so little is expected.
    thin = camera.without_unit and inliers < options.thin_mono * len(frame.features)
    # A keyframe without its frame's outliers has a fresh point in place of each, which it alone sees: found again, it
    # counts among the inliers, but not among what is expected. So the expected points alone would ask too late.
    sparse = inliers < held_share * int(np.count_nonzero(points >= 0))
    due = overdue or mapper_is_ready or weak
    wanted = inliers < ratio * expected or needs_close or thin or sparse
    return due and wanted and inliers > MIN_INLIERS


def _needs_close_points(camera: CameraModel, enough: int, frame: TrackedFrame) -> bool:
    depth = frame.features.depth
    close = (depth > 0) & (depth < camera.close_depth)
    tracked = (frame.points >= 0) & ~frame.outlier
    tracked_close = int(np.count_nonzero(close & tracked))
    untracked_close = int(np.count_nonzero(close & ~tracked))
    return tracked_close < enough and untracked_close > CLOSE_UNTRACKED
