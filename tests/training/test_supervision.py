"""Outlier removal by the paper's two rules, and the make-up of samples."""

from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.multiview import points_in_camera
from prgbd.core.types import Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory
from prgbd.training import supervision

from .scenes import WallSequence, true_slam_result


@pytest.fixture
def result():
    return true_slam_result(WallSequence())


def tiny(uv_error):
    """Four keyframes in a row; point 0 seen by all, 1 by two, 2 by three, one of which is off by ``uv_error``."""
    camera = PinholeCamera(100, 80, 50.0, 50.0, 49.5, 39.5)
    wTc = np.tile(np.eye(4), (4, 1, 1))
    wTc[:, 0, 3] = [0, 0.1, 0.2, 0.3]
    xyz = np.array([[0.0, 0, 2], [0.5, 0, 3], [0.2, 0.3, 4]])
    keyframe, point = np.array([0, 1, 2, 3, 0, 1, 1, 2, 3]), np.array([0, 0, 0, 0, 1, 1, 2, 2, 2])
    uv = np.concatenate([camera.project((xyz[p] - wTc[k, :3, 3])[None]) for k, p in zip(keyframe, point, strict=True)])
    uv[7] += uv_error
    rows = np.array([2, 5, 8, 11])
    return SlamResult(
        camera=camera,
        mode="rgbd",
        frames=12,
        trajectory=Trajectory.empty(),
        keyframes=Keyframes(rows, rows / 10, wTc, np.zeros(4, np.int32)),
        points=MapPoints(xyz, np.zeros((3, 3), np.uint8)),
        observations=Observations(keyframe, point, uv.astype(np.float32), np.zeros(9, np.float32)),
        states=["ok"] * 12,
        inliers=np.zeros(12, np.int32),
    )


@pytest.mark.parametrize(("error", "kept"), [([0, 2.9], True), ([0, 3.1], False), ([2.5, 2.5], False)])
def test_outliers_go_by_both_rules(error, kept):
    cleaned = supervision.clean_observations(tiny(error))
    pairs = set(zip(cleaned.point.tolist(), cleaned.keyframe.tolist(), strict=True))
    # Point 1 has two observers only; the bad observation goes alone, its point still counts three observers.
    assert pairs == {(0, 0), (0, 1), (0, 2), (0, 3), (2, 1), (2, 3)} | ({(2, 2)} if kept else set())


def test_a_point_behind_its_keyframe_goes():
    result = tiny([0, 0])
    xyz = result.points.xyz.copy()
    xyz[0, 2] = -2
    cleaned = supervision.clean_observations(replace(result, points=replace(result.points, xyz=xyz)))
    assert set(cleaned.point.tolist()) == {2}


def test_thresholds_can_be_chosen():
    assert len(supervision.clean_observations(tiny([0, 4]), min_keyframes=2, max_reprojection_error=5)) == 9
    assert len(supervision.clean_observations(tiny([0, 0]), min_keyframes=4)) == 4


def test_samples_hold_true_geometry(result):
    sequence = WallSequence()
    found = supervision.keyframe_samples(result)
    assert found.keyframes == 4
    assert [s.current for s in found.samples] == [3, 6]
    assert found.skipped == {supervision.NO_KEYFRAME_BEFORE: 1, supervision.NO_KEYFRAME_AFTER: 1}
    sample = found.samples[0]
    assert sample.adjacent.tolist() == [2, 4]
    assert sample.neighbours.tolist() == [0, 6]
    assert sample.frames.tolist() == [3, 2, 4, 0, 6]
    assert len(sample.point) > 100
    for view, frame in enumerate((3, 0, 6)):
        local = points_in_camera(sequence.poses[frame], result.points.xyz[sample.point])
        assert np.allclose(sequence.camera.project(local), sample.uv[view], atol=1e-3)
        assert np.allclose(local[:, 2], sample.depth[view], rtol=1e-5)
    c = points_in_camera(sequence.poses[3], result.points.xyz[sample.point])
    moved = c @ sample.kTc[1, :3, :3].T + sample.kTc[1, :3, 3]
    assert np.allclose(moved[:, 2], sample.depth[2], rtol=1e-5)
    assert np.allclose(sample.aTc[1], np.linalg.inv(sequence.poses[4]) @ sequence.poses[3])


def test_lost_neighbours_are_counted():
    found = supervision.keyframe_samples(true_slam_result(WallSequence(), lost=(4,)))
    assert [s.current for s in found.samples] == [6]
    assert found.skipped[supervision.NO_ADJACENT_FRAME] == 1


def test_samples_stay_within_their_map():
    result = true_slam_result(WallSequence(24), map_of=[0, 0, 0, 0, 1, 1, 1, 1])
    found = supervision.keyframe_samples(result)
    assert [s.current for s in found.samples] == [3, 6, 15, 18]
    assert found.samples[1].neighbours.tolist() == [3, 9]
    assert found.samples[2].neighbours.tolist() == [12, 18]
    assert found.skipped == {supervision.NO_KEYFRAME_BEFORE: 2, supervision.NO_KEYFRAME_AFTER: 2}
    assert [[s.current for s in part.samples] for part in found.by_map()] == [[3, 6], [15, 18]]


def test_neighbours_may_be_further_away():
    found = supervision.keyframe_samples(true_slam_result(WallSequence(24)), keyframe_gap=2, frame_gap=2)
    first = found.samples[0]
    assert (first.current, first.neighbours.tolist(), first.adjacent.tolist()) == (6, [0, 12], [4, 8])


@pytest.mark.parametrize(("step", "gap"), [(0.08, 1), (0.03, 3), (0.0001, 15)])
def test_the_measured_gap_follows_the_motion(step, gap):
    """The wall is 5 m away, so 1.5 % of the depth are 75 mm; the camera moves 1.03 steps a frame."""
    result = true_slam_result(WallSequence(48, step=step), scale=0.1)
    assert supervision.measured_gap(result) == gap
    if gap < 15:
        found = supervision.keyframe_samples(result, frame_gap=0).samples[0]
        assert found.adjacent.tolist() == [found.current - gap, found.current + gap]


def test_the_measured_gap_leaves_a_short_recording_its_samples():
    """Fifteen frames on, none of its keyframes has a frame; four on, half of them do."""
    result = true_slam_result(WallSequence(9, step=0.0001))
    assert supervision.measured_gap(result) == 5
    assert supervision.measured_gap(true_slam_result(WallSequence(48, step=0.0001), lost=range(1, 48, 2))) == 1


def test_nothing_to_measure_is_a_gap_of_one(result):
    seen = result.observations
    blind = Observations(seen.keyframe[:0], seen.point[:0], seen.uv[:0], seen.depth[:0])
    assert supervision.measured_gap(replace(result, observations=blind)) == 1


def test_a_neighbour_without_common_points_is_passed_over(result):
    """Keyframe 1 (frame 3) loses its points: keyframe 2 then pairs with keyframe 0."""
    seen = result.observations
    keep = seen.keyframe != 1
    blind = Observations(seen.keyframe[keep], seen.point[keep], seen.uv[keep], seen.depth[keep])
    found = supervision.keyframe_samples(replace(result, observations=blind))
    by_frame = {s.current: s for s in found.samples}
    assert by_frame[6].neighbours.tolist() == [0, 9]
    assert len(by_frame[6].point) > 50
    # Frame 3 itself shares nothing with anybody: the nearest serve, and its photometric term still trains.
    assert by_frame[3].neighbours.tolist() == [0, 6]
    assert by_frame[3].uv.shape == (3, 0, 2)


def test_points_beyond_the_sensors_reach_are_left_out(result):
    """Rays that hardly cross put a point anywhere: here it slides out along the ray of keyframe 1."""
    point = int(supervision.keyframe_samples(result).samples[0].point[0])
    xyz, wTc = result.points.xyz.copy(), result.keyframes.wTc[1]
    xyz[point] = wTc[:3, 3] + 5000 * (xyz[point] - wTc[:3, 3])
    far = replace(result, points=replace(result.points, xyz=xyz))
    found = supervision.keyframe_samples(far, max_reprojection_error=1e4).samples[0]
    assert point not in found.point
    assert found.depth.max() <= result.observations.depth.max()
    kept = supervision.keyframe_samples(far, max_reprojection_error=1e4, far_points="keep").samples[0]
    assert point in kept.point
    # Without any measured depth (monocular SLAM) nothing is known about the reach.
    blind = replace(far, observations=replace(far.observations, depth=np.zeros_like(far.observations.depth)))
    assert point in supervision.keyframe_samples(blind, max_reprojection_error=1e4).samples[0].point


def test_parallax_decides_about_far_points_instead_of_the_sensors_reach(result):
    """With a sensor that reaches less far than the wall, the wall's points stay; one slid out to infinity goes."""
    reach = np.median(result.observations.depth)
    near = np.minimum(result.observations.depth, reach)
    point = int(supervision.keyframe_samples(result).samples[0].point[0])
    xyz, wTc = result.points.xyz.copy(), result.keyframes.wTc[1]
    xyz[point] = wTc[:3, 3] + 5000 * (xyz[point] - wTc[:3, 3])
    short = replace(
        result,
        points=replace(result.points, xyz=xyz),
        observations=replace(result.observations, depth=near.astype(np.float32)),
    )
    by_reach = supervision.keyframe_samples(short, max_reprojection_error=1e4).samples[0]
    by_angle = supervision.keyframe_samples(short, max_reprojection_error=1e4, min_parallax=1.0).samples[0]
    assert by_reach.depth.max() <= reach < by_angle.depth.max() < 100
    assert point not in by_angle.point
    assert len(by_angle.point) > len(by_reach.point)


def test_all_points_of_a_keyframe_may_teach_its_depth(result):
    common = supervision.keyframe_samples(result).samples[0]
    assert np.array_equal(common.seen_uv, common.uv[0])
    assert np.array_equal(common.seen_depth, common.depth[0])
    every = supervision.keyframe_samples(result, consistency_points="all").samples[0]
    cleaned = supervision.clean_observations(result)
    mine = cleaned.keyframe == 1
    assert len(every.seen_depth) == mine.sum() > len(common.seen_depth)
    local = points_in_camera(result.keyframes.wTc[1], result.points.xyz[cleaned.point[mine]])
    order, expected = np.argsort(every.seen_depth), np.sort(local[:, 2])
    assert np.allclose(every.seen_depth[order], expected, rtol=1e-5)
    lifted = result.camera.backproject(every.seen_uv.astype(float), every.seen_depth.astype(float))
    assert np.abs(result.camera.project(lifted) - every.seen_uv).max() < 1e-3
    # What the three keyframes share is the same as before: depth transfer needs it.
    assert np.array_equal(every.uv, common.uv)


def test_an_empty_result_gives_nothing():
    result = tiny([0, 0])
    empty = replace(
        result,
        keyframes=Keyframes(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 4, 4)), np.zeros(0, np.int32)),
        points=MapPoints(np.zeros((0, 3)), np.zeros((0, 3), np.uint8)),
        observations=Observations(
            np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2), np.float32), np.zeros(0, np.float32)
        ),
    )
    found = supervision.keyframe_samples(empty)
    assert found.samples == []
    assert found.points_per_sample == 0
