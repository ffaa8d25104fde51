"""A distorted camera: keypoints are undistorted, depth and colour are read where they were found."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import prgbd
from prgbd.core.types import Frame
from prgbd.core.undistortion import Undistorter
from prgbd.evaluation.trajectory import evaluate_trajectory
from prgbd.plugins.data.tum_rgbd import FAMILIES, TumRgbdSequence
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.frame_reader import FrameReader
from prgbd.plugins.slam.orb_gtsam.settings import FeatureOptions

# TUM RGB-D, colour camera of freiburg 1.
FREIBURG = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)


@pytest.fixture(scope="module")
def sequence():
    return prgbd.make_data("synthetic", scene="indoor", frames=20, width=320, height=240, sensor_depth=True)


def distorted(sequence, index):
    """What the camera would see through the lens."""
    camera, frame = sequence.camera, sequence.frame(index)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(pixels, camera.K, np.array(FREIBURG), P=camera.K)
    x, y = straight.reshape(camera.height, camera.width, 2).astype(np.float32).transpose(2, 0, 1)
    image = cv2.remap(frame.image, x, y, cv2.INTER_LINEAR)
    depth = cv2.remap(frame.depth, x, y, cv2.INTER_NEAREST)
    return Frame(frame.index, frame.timestamp, image, depth)


def test_keypoints_lie_where_the_pinhole_camera_sees_them(sequence):
    given = replace(sequence.camera, distortion=FREIBURG)
    options = FeatureOptions()
    reader = FrameReader(options, given, "rgbd")
    camera = CameraModel(sequence.camera, False, 0.1, 4.0, options.scales(), reader.left.columns)
    features = reader.read(distorted(sequence, 0), camera)
    inside = (features.uv > -0.5) & (features.uv < [given.width - 0.5, given.height - 0.5])
    assert inside.all()
    counts = np.diff(features.cell_start)
    assert counts.sum() == len(features)
    cell = (features.uv // 20).astype(int).clip(0)
    np.testing.assert_array_equal(
        np.repeat(np.arange(len(counts)), counts), cell[:, 1] * reader.left.columns + cell[:, 0]
    )
    pixel = np.rint(features.uv).astype(int)
    true = sequence.depth(0)[pixel[:, 1].clip(0, 239), pixel[:, 0].clip(0, 319)]
    assert np.mean(np.abs(features.depth / true - 1) < 0.02) > 0.85


def test_the_trajectory_is_that_of_the_undistorted_camera(sequence):
    camera = replace(sequence.camera, distortion=FREIBURG)
    with prgbd.make_slam("orb_gtsam") as slam:
        slam.reset(camera, "rgbd", baseline=0.1, fps=10.0)
        for index in range(len(sequence)):
            slam.track(distorted(sequence, index))
        result = slam.finish()
    assert result.camera == sequence.camera
    assert result.tracked_frames == 20
    figures = evaluate_trajectory(result.trajectory, 20, sequence.poses, sequence.timestamps, alignment="se3")
    assert figures["ate_rmse"] < 0.02


def test_a_real_lens_needs_no_undistorted_images(shared_data):
    """Needs ../shared; without it ``test_the_trajectory_is_that_of_the_undistorted_camera`` stands in."""
    folder = shared_data("tum_rgbd")
    sequence = TumRgbdSequence(folder)
    recording = folder / "rgbd_dataset_freiburg1_rpy"
    camera = FAMILIES["freiburg1"]
    sequence._undistorter = Undistorter(camera.undistorted())  # images and depth as they were recorded
    recorded = cv2.imread(str(next(iter(sorted((recording / "rgb").iterdir())))))
    np.testing.assert_array_equal(sequence.frame(0).image, cv2.cvtColor(recorded, cv2.COLOR_BGR2RGB))
    with prgbd.make_slam("orb_gtsam") as slam:
        slam.reset(camera, "rgbd", baseline=0.08, fps=sequence.fps)
        for index in range(len(sequence)):
            slam.track(sequence.frame(index))
        result = slam.finish()
    assert result.camera == camera.undistorted()
    assert result.tracked_frames == len(sequence) == 60
    figures = evaluate_trajectory(result.trajectory, 60, sequence.poses, sequence.timestamps)
    assert figures["ate_rmse"] < 0.04
