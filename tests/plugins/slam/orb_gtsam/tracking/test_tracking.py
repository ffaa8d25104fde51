"""The SLAM system on made-up walls with known poses: accuracy, repeatability, loss and recovery."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.core.errors import ContractError
from prgbd.core.slam import TrackingState
from prgbd.core.testing.planar_scene import planar_scene
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.map.keyframe_creation import KeyframeCreator
from tests.contracts import SlamContract
from tests.plugins.slam.orb_gtsam.walls import CAMERA, error, path, pose, view


class TestContract(SlamContract):
    @pytest.fixture
    def system(self) -> OrbGtsamSLAM:
        return OrbGtsamSLAM()


POSES = path(36)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [view(i, wTc) for i, wTc in enumerate(POSES)]


def run(frames: list[Frame], mode: str = "rgbd", **options) -> SlamResult:
    with OrbGtsamSLAM(**options) as system:
        system.reset(CAMERA, mode, baseline=None if mode == "mono" else 0.1, fps=10.0)
        for frame in frames:
            system.track(frame)
        return system.finish()


def truth_of(result: SlamResult, poses: list[np.ndarray]) -> np.ndarray:
    return np.stack([poses[i][:3, 3] for i in result.trajectory.frame_index])


@pytest.fixture(scope="module")
def rgbd(frames) -> SlamResult:
    return run(frames)


def test_depth_gives_the_trajectory_in_metres(rgbd) -> None:
    assert rgbd.tracked_frames == len(POSES)
    assert set(rgbd.states) == {"ok"}
    assert error(rgbd.trajectory.positions, truth_of(rgbd, POSES), scale=False) < 0.01
    turned = np.linalg.inv(POSES[0]) @ POSES[-1]
    found = np.linalg.inv(rgbd.trajectory.wTc[0]) @ rgbd.trajectory.wTc[-1]
    assert np.degrees(np.arccos((np.trace(found[:3, :3].T @ turned[:3, :3]) - 1) / 2)) < 0.6


def test_two_views_give_the_trajectory_up_to_scale(frames) -> None:
    result = run(frames, "mono")
    assert result.tracked_frames == len(POSES)
    assert error(result.trajectory.positions, truth_of(result, POSES), scale=True) < 0.01
    assert (result.observations.depth == 0).all()


def test_the_result_is_complete_and_consistent(rgbd, frames) -> None:
    seen, keyframes = rgbd.observations, rgbd.keyframes
    assert len(keyframes) >= 3
    assert len(rgbd.points) > 300
    assert rgbd.online is not None
    assert len(rgbd.online) == len(rgbd.trajectory)
    assert set(keyframes.frame_index.tolist()) <= set(rgbd.trajectory.frame_index.tolist())
    # Every point is seen, projects near its keypoint, and has the colour and depth of the image there.
    assert np.bincount(seen.point, minlength=len(rgbd.points)).min() >= 1
    cTw = np.linalg.inv(keyframes.wTc)[seen.keyframe]
    local = np.einsum("nij,nj->ni", cTw[:, :3, :3], rgbd.points.xyz[seen.point]) + cTw[:, :3, 3]
    distance = np.linalg.norm(rgbd.camera.project(local) - seen.uv, axis=1)
    assert np.median(distance) < 1.0
    measured = seen.depth > 0
    assert measured.mean() > 0.9
    assert np.median(np.abs(seen.depth[measured] / local[measured, 2] - 1)) < 0.01
    at = np.rint(seen.uv).astype(int)
    images = np.stack([f.image for f in frames])[keyframes.frame_index[seen.keyframe], at[:, 1], at[:, 0]]
    assert np.median(np.abs(images.astype(int) - rgbd.points.rgb[seen.point].astype(int))) < 20


def test_the_statistics_say_what_happened(rgbd) -> None:
    stats = rgbd.stats
    assert stats["keyframes_added"] - stats["keyframes_culled"] == len(rgbd.keyframes)
    assert stats["lost_frames"] == 0
    assert stats["stages_ms"]["features"]["runs"] == len(POSES)
    assert len(stats["depth_ratio"]) == len(POSES)
    assert np.median(np.abs(np.array(stats["depth_ratio"][1:], float) - 1)) < 0.01
    assert stats["full_ba"]["maps"][0]["final_cost"] <= stats["full_ba"]["maps"][0]["initial_cost"]


def test_two_runs_are_identical(frames, rgbd) -> None:
    again = run(frames)
    np.testing.assert_array_equal(again.trajectory.wTc, rgbd.trajectory.wTc)
    np.testing.assert_array_equal(again.points.xyz, rgbd.points.xyz)


def test_depth_of_a_wrong_scale_scales_the_map(frames) -> None:
    doubled = [f.with_depth(2.0 * f.depth) for f in frames[:15]]
    result = run(doubled)
    length = np.linalg.norm(np.diff(result.trajectory.positions, axis=0), axis=1).sum()
    truth = np.linalg.norm(np.diff(truth_of(result, POSES), axis=0), axis=1).sum()
    assert length / truth == pytest.approx(2.0, rel=0.06)


def blank(index: int) -> Frame:
    return Frame(index, index * 0.1, np.zeros((240, 320, 3), np.uint8), np.ones((240, 320), np.float32))


def test_blank_frames_are_lost_and_the_map_is_found_again(frames) -> None:
    mixed = [blank(i) if 25 <= i < 30 else frame for i, frame in enumerate(frames)]
    result = run(mixed, tracking={"restart_keyframes": 0})
    assert [i for i, s in enumerate(result.states) if s == TrackingState.LOST] == [25, 26, 27, 28, 29]
    assert result.stats["maps"] == 1
    assert (result.inliers[25:30] == 0).all()
    assert error(result.trajectory.positions, truth_of(result, POSES), scale=False) < 0.01


def test_a_jump_back_to_a_known_place_is_recovered(frames) -> None:
    poses = [*POSES, pose(0.05, 0.02, 0.01, 0.01), pose(0.07, 0.02, 0.01, 0.01)]
    jump = [view(len(POSES) + i, wTc) for i, wTc in enumerate(poses[-2:])]
    result = run([*frames, *jump], tracking={"restart_keyframes": 0})
    assert result.tracked_frames == len(poses)
    assert error(result.trajectory.positions, truth_of(result, poses), scale=False) < 0.01


def test_a_young_system_that_is_lost_starts_a_new_map(frames) -> None:
    system = OrbGtsamSLAM(tracking={"restart_keyframes": 5})
    system.reset(CAMERA, "rgbd", baseline=0.1, fps=10.0)
    for frame in frames[:4]:
        system.track(frame)
    assert system.track(blank(4)).state is TrackingState.LOST
    assert system.track(blank(5)).state is TrackingState.LOST
    elsewhere = [view(6 + i, pose(-6.0 + 0.02 * i)) for i in range(4)]
    assert [system.track(f).state.value for f in elsewhere] == ["ok"] * 4
    result = system.finish()
    assert result.stats["maps"] == 2
    assert sorted(set(result.keyframes.map_id.tolist())) == [0, 1]
    assert result.tracked_frames == 8
    step = np.diff(result.trajectory.positions[4:], axis=0)
    np.testing.assert_allclose(step[:, 0], 0.02, atol=0.01)


def test_a_sequence_without_anything_to_see_has_an_empty_result() -> None:
    result = run([blank(i) for i in range(3)])
    assert (result.tracked_frames, len(result.keyframes), len(result.points)) == (0, 0, 0)
    assert result.states == ["not_initialized"] * 3
    assert run([]).frames == 0


@pytest.mark.parametrize("kept", [True, False])
def test_outliers_go_along_into_keyframes_only_if_they_may(frames, kept: bool, monkeypatch) -> None:
    refuted = []
    add = KeyframeCreator.add

    def watched(creator, index, timestamp, cTw, features, points):
        rows = np.flatnonzero((points >= 0) & (features.depth > 0) & (features.octave <= 1))
        seen = creator.map.points.xyz[points[rows]] @ cTw[2, :3] + cTw[2, 3]
        refuted.append(int(np.count_nonzero(np.abs(seen - features.depth[rows]) > 0.5 * seen)))
        return add(creator, index, timestamp, cTw, features, points)

    monkeypatch.setattr(KeyframeCreator, "add", watched)
    wrong = []
    for frame in frames[:12]:
        depth = frame.depth.copy()
        depth[80:160, 100:200] *= 3.0 if frame.index % 3 == 2 else 1.0
        wrong.append(frame.with_depth(depth))
    # Wide windows and no gate let wrong depths become matches, as a depth camera that turns fast does.
    result = run(wrong, keyframes={"outliers": kept, "ratio": 2.0, "ratio_first": 2.0}, depth={"gate": False})
    assert result.tracked_frames == 12
    assert len(refuted) > 6
    assert (max(refuted) > 10) == kept


def test_unknown_depth_is_survived(frames) -> None:
    holes, rng = [], np.random.default_rng(0)
    for frame in frames[:12]:
        depth = frame.depth.copy()
        depth[:, :120] = 0.0
        depth[rng.random(depth.shape) < 0.5] = 0.0
        holes.append(frame.with_depth(depth))
    result = run(holes)
    assert result.tracked_frames == 12
    assert error(result.trajectory.positions, truth_of(result, POSES), scale=False) < 0.01


def test_wrong_order_and_wrong_frames_are_refused(frames) -> None:
    system = OrbGtsamSLAM()
    with pytest.raises(ContractError, match="reset"):
        system.track(frames[0])
    system.reset(CAMERA, "rgbd", baseline=0.1)
    with pytest.raises(ContractError, match="depth"):
        system.track(frames[0].with_depth(None))
    with pytest.raises(ContractError, match="image"):
        system.track(Frame(0, 0.0, np.zeros((10, 10, 3), np.uint8), frames[0].depth))
    system.close()
    system.close()
    with pytest.raises(ContractError, match="reset"):
        system.finish()


def test_depth_beyond_what_is_trusted_makes_no_stereo_observation(frames) -> None:
    result = run(frames[:12], depth={"trust": 30.0})  # 3 metres at a baseline of 0.1: the farther wall is beyond
    assert result.tracked_frames == 12
    assert error(result.trajectory.positions, truth_of(result, POSES), scale=False) < 0.02
    plain, generous = run(frames[:12]), run(frames[:12], depth={"trust": 1000.0})
    np.testing.assert_array_equal(generous.trajectory.wTc, plain.trajectory.wTc)
    assert not np.array_equal(result.trajectory.wTc, plain.trajectory.wTc)


def test_a_plane_starts_a_map_only_with_enough_parallax() -> None:
    """A pure plane leaves two motions that explain it; taken too early the wrong one wins."""
    frames = planar_scene(count=24)
    system = OrbGtsamSLAM()
    camera = PinholeCamera.from_fov(320, 240, 60.0)
    system.reset(camera, "mono", fps=10.0)
    for frame in frames:
        system.track(frame)
    result = system.finish()
    steps = np.diff(result.trajectory.positions[::4], axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    assert result.tracked_frames == len(frames)
    assert (np.abs(steps[:, 0]) > 0.9).all()
