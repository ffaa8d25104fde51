"""Lost frames are found in any map that knows their place; only a place that none knows starts a new map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.types import Frame
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from tests.plugins.slam.orb_gtsam.walls import CAMERA, error, path, pose, view

POSES = path(80)
BLACKOUT = range(26, 66)
# A part of the wall that shares nothing with the path.
ELSEWHERE = [pose(-6.0 - 0.02 * i) for i in range(14)]


def black(index: int) -> Frame:
    return Frame(index, index * 0.1, np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32))


def begin(mode: str = "rgbd", **options) -> OrbGtsamSLAM:
    system = OrbGtsamSLAM(**options)
    system.reset(CAMERA, mode, baseline=None if mode == "mono" else 0.1, fps=10.0)
    return system


def states_of(system: OrbGtsamSLAM, frames: list[Frame]) -> list[str]:
    return [system.track(frame).state.value for frame in frames]


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [view(i, wTc) for i, wTc in enumerate(POSES)]


@pytest.fixture(scope="module")
def journey(frames) -> list[Frame]:
    """A walk, a place far from it, and the walk's beginning again."""
    poses = [*POSES[:26], *ELSEWHERE, *POSES[10:16]]
    return [view(i, wTc) for i, wTc in enumerate(poses)]


@pytest.mark.parametrize("mode", ["rgbd", "mono"])
def test_after_a_blackout_the_moved_camera_is_found_in_the_same_map(frames, mode) -> None:
    mixed = [black(i) if i in BLACKOUT else frame for i, frame in enumerate(frames)]
    with begin(mode) as system:
        for frame in mixed:
            system.track(frame)
        result = system.finish()
    assert result.states[26:66] == ["lost"] * 40
    assert result.states.index("ok", 66) - 66 < 3
    assert set(result.states[69:]) == {"ok"}
    assert result.stats["maps"] == 1
    assert set(result.keyframes.map_id.tolist()) == {0}
    truth = np.stack([POSES[i][:3, 3] for i in result.trajectory.frame_index])
    assert error(result.trajectory.positions, truth, scale=mode == "mono") < 0.015


def test_black_frames_neither_start_a_map_nor_cost_a_search(frames) -> None:
    with begin(tracking={"restart_after": 3, "restart_keyframes": 99}) as system:
        states_of(system, frames[:10])
        asked = []
        system._database.query = lambda *_, **__: asked.append(1)
        assert states_of(system, [black(10 + i) for i in range(30)]) == ["lost"] * 30
        assert not asked
        assert system.finish().stats["maps"] == 1


def test_an_unknown_place_starts_a_map_once_enough_frames_showed_it(journey) -> None:
    with begin(tracking={"restart_after": 5, "restart_keyframes": 0}) as system:
        assert set(states_of(system, journey[:26])) == {"ok"}
        dark = [replace(frame, image=np.zeros_like(frame.image)) for frame in journey[26:28]]
        assert states_of(system, [*dark, *journey[28:38]]) == ["lost"] * 6 + ["ok"] * 6
        slam_map = system._map
        shared = system._covisibility.common(slam_map.points_of(slam_map.keyframes.count - 1))
        assert not shared[slam_map.keyframes.map_id[: slam_map.keyframes.count] == 0].any()
        result = system.finish()
    assert result.stats["maps"] == 2
    assert result.stats["lost_frames"] == 6


@pytest.mark.parametrize("loop_closing", [False, True])
def test_a_lost_frame_is_found_in_an_older_map_than_the_present_one(journey, loop_closing) -> None:
    with begin(tracking={"restart_after": 2, "restart_keyframes": 0}, loop_closing={"enabled": loop_closing}) as system:
        states_of(system, journey[:40])
        slam_map = system._map
        assert slam_map.current_map == 1
        assert states_of(system, journey[40:]) == ["ok"] * 6
        assert slam_map.current_map == 0
        result = system.finish()
    # Where the frames of the walk's beginning were found agrees with where they were the first time.
    positions = dict(zip(result.trajectory.frame_index.tolist(), result.trajectory.positions, strict=True))
    apart = [np.linalg.norm(positions[40 + i] - positions[10 + i]) for i in range(6)]
    assert max(apart) < 0.03


def test_while_no_map_starts_each_frame_is_looked_for_in_the_old_ones(journey) -> None:
    # Nothing can start a map here, as it would take more keypoints than there are.
    with begin(tracking={"restart_after": 2, "restart_keyframes": 0}) as system:
        states_of(system, journey[:26])
        system._front_end.initializer.least_keypoints = 10_000
        assert states_of(system, journey[26:40]) == ["lost"] * 14
        assert states_of(system, journey[40:]) == ["ok"] * 6
        assert system.finish().stats["maps"] == 1


def test_the_number_of_places_tried_is_bounded(journey) -> None:
    with begin(tracking={"recovery_keyframes": 4, "restart_after": 99}) as system:
        states_of(system, journey[:26])
        relocaliser, tried = system._front_end.relocaliser, []
        attempt = relocaliser._pose_against
        relocaliser._pose_against = lambda frame, k: tried.append(k) or attempt(frame, k)
        states_of(system, journey[26:29])
    assert 3 <= len(tried) <= 3 * 4


def test_two_runs_with_losses_are_identical(journey) -> None:
    results = []
    for _ in range(2):
        with begin(tracking={"restart_after": 2, "restart_keyframes": 0}) as system:
            states_of(system, journey)
            results.append(system.finish())
    np.testing.assert_array_equal(results[0].trajectory.wTc, results[1].trajectory.wTc)
    np.testing.assert_array_equal(results[0].keyframes.map_id, results[1].keyframes.map_id)
