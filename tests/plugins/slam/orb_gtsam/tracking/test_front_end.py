"""The way of frames of a cloud through the front end: starts, tracking, keyframes, loss and new maps."""

from __future__ import annotations

import numpy as np

from prgbd.core.slam import TrackingResult, TrackingState
from prgbd.plugins.slam.orb_gtsam.diagnostics.stage_times import Stopwatch
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.loop_closing.keyframe_database import KeyframeDatabase
from prgbd.plugins.slam.orb_gtsam.map.keyframe_creation import KeyframeCreator
from prgbd.plugins.slam.orb_gtsam.tracking.front_end import FrontEnd, Handover
from prgbd.plugins.slam.orb_gtsam.tracking.initializer import DepthInitializer
from prgbd.plugins.slam.orb_gtsam.tracking.relocalisation import Relocaliser
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.tracking.tracker import Tracker
from tests.plugins.slam.orb_gtsam.cloud import Cloud, at

FPS = 100.0


class Drive:
    """A front end and a cloud that it sees."""

    def __init__(self, **options: object) -> None:
        self.cloud = cloud = Cloud(160, **options)
        self.tracker = Tracker(cloud.settings, cloud.camera, cloud.map, cloud.covisibility)
        creator = KeyframeCreator(cloud.camera, cloud.map, cloud.covisibility)
        self.front_end = FrontEnd(
            self.tracker,
            Relocaliser(self.tracker, KeyframeDatabase()),
            DepthInitializer(creator, 60),
            creator,
            lambda: True,
            Stopwatch(),
            FPS,
        )
        self.frames = 0

    def track(self, cTw: np.ndarray, which: np.ndarray) -> tuple[TrackingResult, list[Handover]]:
        """Track a frame that shows some of the cloud."""
        features, _ = self.cloud.see(cTw, which)
        frame = TrackedFrame(10 + self.frames, 0.1 * self.frames, self.frames, features)
        self.frames += 1
        return self.front_end.track(frame)


HERE, THERE = np.arange(80), np.arange(80, 160)
NOTHING = np.arange(0)


def test_a_frame_with_depth_starts_the_map() -> None:
    drive = Drive()
    result, handovers = drive.track(at(0.0), HERE)
    assert (result.state, result.inliers, result.is_keyframe) == (TrackingState.OK, 80, True)
    np.testing.assert_array_equal(result.wTc, np.eye(4))
    assert handovers == [Handover(0, local_mapping=False)]
    xyz = drive.cloud.map.points.xyz[:80]
    np.testing.assert_allclose(np.sort(xyz[:, 2]), np.sort(drive.cloud.xyz[HERE, 2]), atol=1e-4)


def test_frames_with_too_little_wait_for_a_start() -> None:
    drive = Drive()
    for seen in (NOTHING, HERE[:60]):
        result, handovers = drive.track(at(0.0), seen)
        assert (result.state, result.wTc, handovers) == (TrackingState.NOT_INITIALIZED, None, [])
    assert drive.cloud.map.current_map == 0
    assert drive.track(at(0.0), HERE)[0].state is TrackingState.OK


def test_frames_are_tracked_to_their_true_pose_without_new_keyframes() -> None:
    drive = Drive()
    drive.track(at(0.0), HERE)
    for step in range(1, 6):
        cTw = at(0.04 * step, 0.01 * step, 0.02 * step)
        result, handovers = drive.track(cTw, HERE)
        assert (result.state, result.is_keyframe, handovers) == (TrackingState.OK, False, [])
        assert result.inliers >= 78
        np.testing.assert_allclose(result.wTc, inverse(cTw), atol=1e-3)
    assert drive.front_end.history.states == ["ok"] * 6
    found = drive.front_end.history.trajectory(drive.cloud.map)
    assert found.frame_index.tolist() == list(range(10, 16))


def test_a_frame_that_lacks_much_of_what_its_keyframe_saw_becomes_a_keyframe_with_new_points() -> None:
    drive = Drive()
    drive.track(at(0.0), HERE)
    cTw = at(0.1)
    result, handovers = drive.track(cTw, np.r_[HERE[:31], THERE[:69]])
    assert result.is_keyframe
    assert handovers == [Handover(1)]
    assert drive.tracker.reference == 1
    slam_map = drive.cloud.map
    assert (slam_map.points_of(1) >= 0).all()
    assert slam_map.observation_counts(slam_map.points_of(0), double=False).sum() == 31 * 2 + 49
    new = slam_map.points_of(1)[slam_map.points.created[slam_map.points_of(1)] == 1]
    truth = drive.cloud.xyz[THERE[:69]]
    nearest = np.linalg.norm(slam_map.points.xyz[new, None] - truth[None], axis=2).min(axis=1)
    assert len(new) == 69
    assert nearest.max() < 0.01


def test_localising_alone_makes_no_keyframes() -> None:
    drive = Drive(localise_only=True)
    drive.track(at(0.0), HERE)
    result, handovers = drive.track(at(0.1), np.r_[HERE[:31], THERE[:69]])
    assert (result.state, result.is_keyframe, handovers) == (TrackingState.OK, False, [])


def test_a_frame_without_anything_to_see_is_lost_and_the_next_one_found() -> None:
    drive = Drive()
    drive.track(at(0.0), HERE)
    drive.track(at(0.05), HERE)
    result, _ = drive.track(at(0.1), NOTHING)
    assert (result.state, result.inliers) == (TrackingState.LOST, 0)
    result, _ = drive.track(at(0.15), HERE)
    assert result.state is TrackingState.OK
    np.testing.assert_allclose(result.wTc, inverse(at(0.15)), atol=1e-3)
    assert drive.cloud.map.map_ids() == [0]


def test_an_unknown_place_starts_a_new_map_where_the_camera_should_be() -> None:
    drive = Drive()
    for step in range(4):
        drive.track(at(0.05 * step), HERE)
    result, handovers = drive.track(at(0.2), THERE)
    assert result.state is TrackingState.OK
    assert handovers == [Handover(1, local_mapping=False)]
    assert drive.cloud.map.map_ids() == [0, 1]
    assert drive.cloud.map.current_map == 1
    # The camera went on by 0.05 m a frame.
    np.testing.assert_allclose(result.wTc, inverse(at(0.2)), atol=5e-3)


def test_a_larger_map_is_given_up_only_after_some_frames() -> None:
    drive = Drive(tracking={"restart_keyframes": 0, "restart_after": 3})
    drive.track(at(0.0), HERE)
    states = [drive.track(at(0.0), THERE)[0].state for _ in range(3)]
    assert states == [TrackingState.LOST, TrackingState.LOST, TrackingState.OK]
