"""Stereo mode: depth of keypoints against the truth, whole runs in true scale, and bad pairs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, ContractError, DataError
from prgbd.evaluation.trajectory import evaluate_trajectory
from prgbd.loop.slam_runs import sensor_input
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.frame_reader import FrameReader
from prgbd.plugins.slam.orb_gtsam.settings import FeatureOptions

BASELINE = 0.2


@pytest.fixture(scope="module")
def pairs():
    return prgbd.make_data("synthetic", scene="indoor", frames=20, width=320, height=240, baseline=BASELINE)


def read(sequence, index):
    options = FeatureOptions()
    reader = FrameReader(options, sequence.camera, "stereo")
    camera = CameraModel(
        sequence.camera, False, BASELINE, 40 * BASELINE, options.scales(), reader.left.columns, stereo=True
    )
    return reader.read(sequence.frame(index), camera), camera


def test_depth_agrees_with_the_truth_to_a_fraction_of_a_pixel(pairs):
    features, camera = read(pairs, 0)
    found = features.depth > 0
    assert found.mean() > 0.4
    pixel = np.rint(features.uv[found]).astype(int)
    true = pairs.depth(0)[np.clip(pixel[:, 1], 0, 239), np.clip(pixel[:, 0], 0, 319)]
    disparity = features.uv[found, 0] - features.u_right[found]
    np.testing.assert_allclose(disparity, camera.bf / features.depth[found], rtol=1e-3, atol=0.02)
    error = (disparity - camera.bf / np.maximum(true, 1e-3))[true > 0]
    assert abs(np.median(error)) < 0.1
    assert np.median(np.abs(error)) < 0.25
    assert np.percentile(np.abs(error), 90) < 1.0


def test_points_without_a_partner_have_no_depth(pairs):
    features, _ = read(pairs, 0)
    missing = features.depth == 0
    assert missing.any()
    assert (features.u_right[missing] == -1).all()
    assert (features.u_right[~missing] >= 0).all()


def test_an_unrelated_right_image_gives_hardly_any_depth(pairs):
    options = FeatureOptions()
    reader = FrameReader(options, pairs.camera, "stereo")
    camera = CameraModel(
        pairs.camera, False, BASELINE, 40 * BASELINE, options.scales(), reader.left.columns, stereo=True
    )
    noise = np.random.default_rng(0).integers(0, 256, pairs.frame(0).image.shape, np.uint8)
    assert (reader.read(replace(pairs.frame(0), right=noise), camera).depth > 0).mean() < 0.05


def test_a_run_has_the_true_scale(pairs):
    with prgbd.make_slam("orb_gtsam") as slam:
        slam.reset(pairs.camera, "stereo", baseline=BASELINE, fps=10.0)
        for index in range(len(pairs)):
            slam.track(pairs.frame(index))
        result = slam.finish()
    assert result.mode == "stereo"
    assert result.tracked_frames == 20
    figures = evaluate_trajectory(result.trajectory, len(pairs), pairs.poses, pairs.timestamps, alignment="se3")
    assert figures["ate_rmse"] < 0.02
    assert evaluate_trajectory(result.trajectory, 20, pairs.poses, pairs.timestamps)["scale"] == pytest.approx(
        1, abs=0.02
    )


def test_bad_pairs_are_refused(pairs):
    frame = pairs.frame(0)
    with prgbd.make_slam("orb_gtsam") as slam:
        slam.reset(pairs.camera, "stereo", baseline=BASELINE)
        with pytest.raises(ContractError, match="no right image"):
            slam.track(replace(frame, right=None))
        slam.reset(pairs.camera, "stereo", baseline=BASELINE)
        with pytest.raises(ContractError, match="right image"):
            slam.track(replace(frame, right=frame.image[:100]))
        with pytest.raises(ConfigError, match="rectified"):
            slam.reset(replace(pairs.camera, distortion=(0.1, 0, 0, 0)), "stereo", baseline=BASELINE)
        with pytest.raises(ConfigError, match="baseline"):
            slam.reset(pairs.camera, "stereo")


def test_a_recording_of_one_camera_cannot_be_stereo():
    alone = prgbd.make_data("synthetic", scene="indoor", frames=2, width=160, height=120)
    with pytest.raises(DataError, match="right images"):
        sensor_input(alone, "stereo", None)


def test_disparities_of_kitti_agree_with_block_matching(shared_data):
    """Needs ../shared; without it ``test_depth_agrees_with_the_truth_to_a_fraction_of_a_pixel`` stands in."""
    sequence = prgbd.make_data("kitti_odometry", root=shared_data("kitti_odometry"), sequence="00", stop=21)
    dense = cv2.StereoSGBM.create(0, 128, 5, 8 * 25, 32 * 25, 1, 31, 10, 100, 2)
    options = FeatureOptions(count=2000)
    reader = FrameReader(options, sequence.camera, "stereo")
    baseline = sequence.baseline
    camera = CameraModel(
        sequence.camera, False, baseline, 40 * baseline, options.scales(), reader.left.columns, stereo=True
    )
    for index in (0, 20):
        frame = sequence.frame(index)
        features = reader.read(frame, camera)
        gray = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (frame.image, frame.right)]
        disparity = dense.compute(*gray) / 16.0
        u, v = np.rint(features.uv).astype(int).T
        other = disparity[v.clip(0, disparity.shape[0] - 1), u.clip(0, disparity.shape[1] - 1)]
        both = (features.depth > 0) & (other > 1)
        difference = (features.uv[:, 0] - features.u_right - other)[both]
        assert both.sum() > 500
        assert abs(np.median(difference)) < 0.2
        assert np.median(np.abs(difference)) < 0.5


def test_kitti_keeps_the_true_scale(shared_data):
    """Needs ../shared; without it ``test_a_run_has_the_true_scale`` stands in."""
    sequence = prgbd.make_data("kitti_odometry", root=shared_data("kitti_odometry"), sequence="00", stop=21)
    given = sensor_input(sequence, "stereo", None)
    with prgbd.make_slam("orb_gtsam") as slam:
        slam.reset(sequence.camera, "stereo", baseline=given.baseline, fps=10.0)
        for frame in given.frames:
            slam.track(frame)
        result = slam.finish()
    figures = evaluate_trajectory(result.trajectory, 21, sequence.poses, sequence.timestamps)
    assert result.tracked_frames == 21
    # The truth moves by exactly 0.86 m a frame at the start, where images show a car that gathers speed.
    assert figures["scale"] == pytest.approx(1.0, abs=0.1)
    assert figures["ate_rmse"] < 0.3
