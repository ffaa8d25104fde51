"""When a frame becomes a keyframe, where that departs from ORB-SLAM2."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.settings import KeyframeOptions
from prgbd.plugins.slam.orb_gtsam.tracking.keyframe_decision import needs_keyframe
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame

KEYPOINTS = 200


def features() -> Features:
    none = np.zeros(KEYPOINTS, np.float32)
    return Features(
        np.zeros((KEYPOINTS, 2), np.float32),
        np.zeros(KEYPOINTS, np.int32),
        none,
        np.zeros((KEYPOINTS, 4), np.uint64),
        none,
        none - 1,
        np.zeros((KEYPOINTS, 3), np.uint8),
        np.zeros(2, np.int32),
    )


@pytest.mark.parametrize(
    ("inliers", "share", "wanted"),
    [(25, 0.15, True), (25, 0.0, False), (40, 0.15, False), (15, 0.15, False)],
    ids=["thin", "as ORB-SLAM2", "enough", "too few to trust"],
)
def test_a_thin_map_gets_keyframes(inliers: int, share: float, wanted: bool) -> None:
    # Four keyframes whose points are each seen by two: none is expected to be found again.
    slam_map = Map(KEYPOINTS, 1, np.ones(1))
    for k in range(4):
        points = np.full(KEYPOINTS, -1, np.int64)
        if k % 2:
            points[:60] = slam_map.points_of(k - 1)[:60]
        slam_map.add_keyframe(k, 0.1 * k, np.eye(4), features(), points)
        if not k % 2:
            slam_map.add_points(k, np.arange(60), np.zeros((60, 3)))
    camera = CameraModel(PinholeCamera(640, 480, 500.0, 500.0, 320.0, 240.0), True, 0.0, 0.0, np.ones(1), 1)
    options = KeyframeOptions(thin_mono=share)
    frame = TrackedFrame(4, 0.4, 4, features())
    assert needs_keyframe(slam_map, camera, options, frame, inliers, 3, 1, 10.0) is wanted


@pytest.mark.parametrize(
    ("inliers", "share", "wanted"),
    [(45, 0.25, True), (45, 0.0, False), (55, 0.25, False), (15, 0.25, False)],
    ids=["few of all that it holds", "as ORB-SLAM2", "enough", "too few to trust"],
)
def test_points_that_the_reference_alone_sees_are_expected_too(inliers: int, share: float, wanted: bool) -> None:
    # All of the last keyframe's keypoints have points, but it shares a few with the others, so that few are expected.
    slam_map = Map(KEYPOINTS, 1, np.ones(1))
    for k in range(4):
        points = np.full(KEYPOINTS, -1, np.int64)
        if k:
            points[:20] = slam_map.points_of(0)[:20]
        slam_map.add_keyframe(k, 0.1 * k, np.eye(4), features(), points)
        fresh = np.flatnonzero(slam_map.points_of(k) < 0)
        slam_map.add_points(k, fresh, np.zeros((len(fresh), 3)))
    camera = CameraModel(PinholeCamera(640, 480, 500.0, 500.0, 320.0, 240.0), False, 40.0, 3.2, np.ones(1), 1)
    frame = TrackedFrame(4, 0.4, 4, features())
    assert needs_keyframe(slam_map, camera, KeyframeOptions(), frame, inliers, 3, 1, 10.0, held_share=share) is wanted
