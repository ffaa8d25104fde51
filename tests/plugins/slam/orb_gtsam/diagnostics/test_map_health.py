import logging

import numpy as np
import pytest

from prgbd.core.types import Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.diagnostics.map_health import doubts_about, jumps, usual_depth
from tests.plugins.slam.orb_gtsam.walls import CAMERA, path, view


def trajectory(centres, frames=None):
    wTc = np.tile(np.eye(4), (len(centres), 1, 1))
    wTc[:, :3, 3] = centres
    frames = np.arange(len(centres)) if frames is None else np.asarray(frames)
    return Trajectory(frames.astype(np.int64), frames / 30.0, wTc)


def walk(steps):
    return np.c_[np.r_[0.0, np.cumsum(steps)], np.zeros((len(steps) + 1, 2))]


def result(path, depth=2.0):
    keyframes = Keyframes(np.array([0]), np.array([0.0]), np.eye(4)[None], np.zeros(1, np.int32))
    points = MapPoints(np.array([[0.0, 0.0, depth]]), np.zeros((1, 3), np.uint8))
    seen = Observations(
        np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros((1, 2), np.float32), np.zeros(1, np.float32)
    )
    states = ["ok"] * len(path)
    camera = PinholeCamera(64, 48, 50.0, 50.0, 32.0, 24.0)
    return SlamResult(camera, "mono", len(path), path, keyframes, points, seen, states, np.zeros(len(path), np.int32))


def test_a_jump_is_told_with_its_frame():
    steps = np.full(40, 0.01)
    steps[25] = 0.3
    found = jumps(trajectory(walk(steps)), depth=2.0)
    assert [frame for frame, _ in found] == [26]
    assert found[0][1] == pytest.approx(30.0)
    # The order of the rows does not matter.
    order = np.random.default_rng(0).permutation(41)
    assert [frame for frame, _ in jumps(trajectory(walk(steps)[order], order), depth=2.0)] == [26]


@pytest.mark.parametrize(
    "steps",
    [
        np.r_[np.zeros(20), np.linspace(0, 0.5, 20)],  # starts from rest
        np.r_[np.full(20, 0.001), np.full(20, 0.4)],  # sets off at once
        np.r_[np.full(20, 0.4), np.zeros(20)],  # stops at once
        np.r_[np.full(20, 1e-5), 1e-3, np.full(20, 1e-5)],  # trembles
        np.full(40, 0.3),
        np.array([0.3]),
        np.zeros(0),
    ],
)
def test_usual_motion_has_no_jumps(steps):
    assert jumps(trajectory(walk(steps)), depth=2.0) == []


def test_a_gap_between_tracked_frames_is_no_jump():
    steps = np.full(40, 0.01)
    steps[20] = 0.5
    frames = np.r_[np.arange(21), np.arange(40, 60)]
    assert jumps(trajectory(walk(steps), frames), depth=2.0) == []


def test_doubts_name_what_was_seen():
    assert usual_depth(result(trajectory(walk(np.full(9, 0.1))))) == 2.0
    smooth = result(trajectory(walk(np.full(40, 0.01))))
    good = {"map": 0, "observations": 1000, "final_cost": 400.0}
    assert doubts_about(smooth, [good]) == []
    assert doubts_about(smooth, [{"map": 0, "keyframes": 900, "skipped": "more than full_ba_keyframes"}]) == []
    assert doubts_about(smooth, []) == []
    bad = {"map": 1, "observations": 1000, "final_cost": 3000.0}
    assert doubts_about(smooth, [good, bad]) == ["keypoints are 2.4 pixels off (1 is usual)"]
    steps = np.full(40, 0.01)
    steps[[12, 30]] = 0.2, 0.3
    (jump,) = doubts_about(result(trajectory(walk(steps))), [good])
    assert jump == "the camera jumps at frame 31 (and at 1 more), 30 times as far as in the frames around it"


def test_a_system_says_what_it_started_from_and_what_is_doubtful(caplog):
    poses = path(24)
    for pose in poses[14:]:
        pose[0, 3] += 0.25
    with OrbGtsamSLAM() as system, caplog.at_level(logging.WARNING):
        system.reset(CAMERA, "rgbd", baseline=0.1, fps=10)
        for i, pose in enumerate(poses):
            system.track(view(i, pose))
        found = system.finish()
    assert found.tracked_frames == 24
    assert [start["frames"] for start in found.stats["starts"]] == [[0]]
    assert found.stats["starts"][0]["points"] > 100
    (doubt,) = found.stats["doubts"]
    assert doubt.startswith("the camera jumps at frame 14, ")
    assert doubt in caplog.text


def test_a_right_map_raises_no_doubts(caplog):
    with OrbGtsamSLAM() as system, caplog.at_level(logging.WARNING):
        system.reset(CAMERA, "mono", fps=10)
        for i, pose in enumerate(path(24)):
            system.track(view(i, pose))
        found = system.finish()
    assert found.stats["doubts"] == []
    assert caplog.text == ""
    (start,) = found.stats["starts"]
    first, second = start["frames"]
    assert first < second
    assert start["points"] >= 50
    assert start["parallax_degrees"] > 1.0
    assert start["model"] in "FH"
