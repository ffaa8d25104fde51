import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import Trajectory
from prgbd.evaluation.trajectory import absolute_error, evaluate_trajectory, kitti_error, relative_error
from prgbd.io.trajectory_files import read_kitti, read_tum, to_evo

RELATIVE = 1e-4


def as_trajectory(wTc, frames=None):
    frames = np.arange(len(wTc)) if frames is None else np.asarray(frames)
    return Trajectory(frames, frames * 0.1, np.asarray(wTc))


def curve(n=60, seed=0):
    """A winding path, (n, 4, 4), about a metre a frame."""
    steps = Rotation.from_rotvec(np.random.default_rng(seed).normal(scale=0.1, size=(n, 3))).as_matrix()
    wTc = np.tile(np.eye(4), (n, 1, 1))
    for i in range(1, n):
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = steps[i], [0, 0, 1]
        wTc[i] = wTc[i - 1] @ step
    return wTc


@pytest.fixture
def reference(golden):
    return json.loads((golden / "trajectory_reference.json").read_text())


@pytest.fixture
def trajectories(shared_reference):
    return shared_reference("trajectories")


@pytest.mark.parametrize("system", ["ORB", "SPTAM"])
def test_published_kitti_figures(trajectories, reference, system):
    """Needs ../shared; without it the hand-made paths below and evo's own figures on them stand in."""
    truth = read_kitti(trajectories / "KITTI_00_gt.txt").wTc
    estimate = read_kitti(trajectories / f"KITTI_00_{system}.txt")
    found, wanted = kitti_error(estimate, truth), reference["relative"][system]
    assert found.translation_percent == pytest.approx(wanted["rel_translation_percent"], rel=RELATIVE)
    assert found.rotation_deg_per_m == pytest.approx(wanted["rel_rotation_deg_per_m"], rel=RELATIVE)
    assert (found.segments, found.skipped) == (wanted["segments"], 0)
    for kind, flag in (("sim3", "-as"), ("se3", "-a")):
        wanted_ate = reference["evo_ape_rmse_m"][f"KITTI_00_{system} {flag}"]
        assert absolute_error(estimate, truth, kind).rmse == pytest.approx(wanted_ate, rel=RELATIVE)


@pytest.mark.parametrize(("kind", "flag"), [("sim3", "-as"), ("se3", "-a")])
def test_published_tum_figures(trajectories, reference, kind, flag):
    """Needs ../shared; without it the hand-made paths below and evo's own figures on them stand in."""
    estimate = read_tum(trajectories / "fr2_desk_ORB.txt")
    matched = read_tum(trajectories / "fr2_desk_groundtruth.txt", estimate.timestamp, max_difference=0.01)
    truth = np.full((len(estimate), 4, 4), np.nan)
    truth[matched.frame_index] = matched.wTc
    wanted = reference["evo_ape_rmse_m"][f"fr2_desk_ORB {flag}"]
    assert absolute_error(estimate, truth, kind).rmse == pytest.approx(wanted, rel=RELATIVE)


def test_kitti_error_of_a_hand_made_path():
    """250 m straight on, 1 m a frame, with 2 % too long steps and 0.01 degrees of yaw a metre."""
    truth = np.tile(np.eye(4), (251, 1, 1))
    truth[:, 2, 3] = np.arange(251)
    # Yaw only turns the camera here, so the translation error is that of the segment seen from its turned first pose.
    angle = np.radians(0.01)
    estimate = truth.copy()
    estimate[:, :3, :3] = Rotation.from_euler("y", np.arange(251)[:, None] * angle).as_matrix()
    estimate[:, 2, 3] *= 1.02
    found = kitti_error(as_trajectory(estimate), truth)
    # A length of L ends at the first frame *beyond* it: L + 1 m after the start. Starts: 0, 10, ... <= 250 - L - 1.
    steps = [(L, L + 1, start) for L in (100, 200) for start in range(0, 250 - L, 10) if start + L + 1 <= 250]
    assert found.segments == len(steps) == 15 + 5
    assert found.rotation_deg_per_m == pytest.approx(np.mean([0.01 * d / L for L, d, _ in steps]), rel=1e-9)
    # |R_start^T d_est - d| in the first camera; rotation by the start's yaw.
    errors = [np.hypot(1.02 * d * np.cos(s * angle) - d, 1.02 * d * np.sin(s * angle)) / L for L, d, s in steps]
    assert found.translation_percent == pytest.approx(100 * np.mean(errors), rel=1e-9)


def test_kitti_segments_without_a_pose_at_an_end_are_skipped_and_counted():
    truth = np.tile(np.eye(4), (121, 1, 1))
    truth[:, 2, 3] = np.arange(121)
    lost = [f for f in range(121) if f != 10]
    found = kitti_error(as_trajectory(truth[lost], lost), truth)
    assert (found.segments, found.skipped) == (1, 1)
    assert found.translation_percent == 0


@pytest.mark.parametrize("kind", ["sim3", "se3", "none"])
def test_alignment_removes_exactly_what_it_says(kind):
    truth = curve()
    scale = 0.3 if kind == "sim3" else 1.0
    moved = truth.copy()
    if kind != "none":
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = Rotation.random(random_state=2).as_matrix(), [4, 5, 6]
        moved = M @ truth
    moved[:, :3, 3] *= scale
    found = evaluate_trajectory(as_trajectory(moved), 60, truth, np.arange(60) * 0.1, alignment=kind)
    assert found["ate_rmse"] == pytest.approx(0, abs=1e-9)
    assert found["scale"] == pytest.approx(1 / scale)
    assert found["rpe_translation"] == pytest.approx(0, abs=1e-9)
    assert found["rpe_rotation_deg"] == pytest.approx(0, abs=1e-4)
    assert found["path_length_m"] == pytest.approx(59)
    assert found["duration_s"] == pytest.approx(5.9)
    stretched = moved.copy()
    stretched[:, :3, 3] *= 2
    wrong = evaluate_trajectory(as_trajectory(stretched), 60, truth, None, alignment="se3")
    assert wrong["ate_rmse"] > 1
    assert evaluate_trajectory(as_trajectory(stretched), 60, truth, None)["ate_rmse"] == pytest.approx(0, abs=1e-9)


def test_known_errors_give_known_statistics():
    truth = curve(4)
    off = truth.copy()
    off[:, 0, 3] += [3, 4, 0, 0]
    found = evaluate_trajectory(as_trajectory(off), 4, truth, None, alignment="none")
    assert found["ate_rmse"] == pytest.approx(2.5)
    assert (found["ate_mean"], found["ate_median"], found["ate_max"]) == pytest.approx((1.75, 1.5, 4))
    assert found["kitti_translation_percent"] is None
    assert found["kitti_segments"] == 0


def test_rpe_equals_evo_and_leaves_out_pairs_across_a_gap():
    from evo.core.metrics import RPE, PoseRelation

    truth, estimate = as_trajectory(curve()), as_trajectory(curve(seed=1))
    translation, rotation, pairs = relative_error(estimate, truth.wTc)
    for relation, value in ((PoseRelation.translation_part, translation), (PoseRelation.rotation_angle_deg, rotation)):
        metric = RPE(relation, delta=1)
        metric.process_data((to_evo(truth), to_evo(estimate)))
        assert value == pytest.approx(metric.get_all_statistics()["rmse"], rel=1e-9)
    assert pairs == 59
    frames = [f for f in range(60) if f not in (20, 21)]
    assert relative_error(as_trajectory(estimate.wTc[frames], frames), truth.wTc)[2] == 56
    assert relative_error(estimate, truth.wTc, delta=5)[2] == 55


def test_frames_are_matched_by_number_and_unknown_truth_is_left_out():
    truth = curve()
    frames = np.array([3, 5, 8, 20, 40, 41])
    partial = truth.copy()
    partial[[5, 50]] = np.nan
    found = evaluate_trajectory(as_trajectory(truth[frames], frames), 60, partial, None)
    assert (found["pairs"], found["tracked_frames"], found["frames"]) == (5, 6, 60)
    assert found["coverage"] == pytest.approx(0.1)
    assert found["ate_rmse"] == pytest.approx(0, abs=1e-9)
    assert found["rpe_pairs"] == 1


@pytest.mark.parametrize("poses", [0, 1, 2])
def test_too_few_poses_are_a_reason_not_an_exception(poses):
    truth = curve()
    found = evaluate_trajectory(as_trajectory(truth[:poses]), 60, truth, None)
    assert found["ate_rmse"] is None
    assert f"Only {poses}" in found["reason"]
    assert found["coverage"] == pytest.approx(poses / 60)
    json.dumps(found, allow_nan=False)


def test_without_truth_or_motion_there_is_a_reason():
    found = evaluate_trajectory(as_trajectory(curve(5)), 5, None, None)
    assert found["ate_rmse"] is None
    assert "no ground truth" in found["reason"]
    still = evaluate_trajectory(as_trajectory(curve(5)), 5, np.tile(np.eye(4), (5, 1, 1)), None)
    assert still["ate_rmse"] is None
    assert "does not move" in still["reason"]


def test_input_that_does_not_fit_is_named():
    truth = curve(5)
    with pytest.raises(DataError, match="5 true poses for 6 frames"):
        evaluate_trajectory(as_trajectory(truth), 6, truth, None)
    with pytest.raises(DataError, match="frame 4 of only 3"):
        evaluate_trajectory(as_trajectory(truth), 3, truth[:3], None)
    with pytest.raises(ConfigError, match="sim3"):
        evaluate_trajectory(as_trajectory(truth), 5, truth, None, alignment="SIM(3)")
