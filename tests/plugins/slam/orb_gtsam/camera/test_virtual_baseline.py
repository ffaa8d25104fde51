"""The adaptive baseline, over the frames so far and with the map following it."""

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.camera.virtual_baseline import RunningBaseline, set_baseline
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_correction import follow_baseline
from prgbd.plugins.slam.orb_gtsam.settings import DepthOptions, FeatureOptions


def test_it_keeps_kittis_ratio_to_the_largest_depth_so_far():
    running = RunningBaseline()
    assert running.see(np.array([[1.0, 40.0], [0.0, np.nan]], np.float32))
    assert running.baseline == pytest.approx(0.27)
    assert not running.see(np.full((2, 2), 41.0, np.float32))
    assert not running.see(np.full((2, 2), 3.0, np.float32))
    assert not running.see(np.zeros((2, 2), np.float32))
    assert running.see(np.full((2, 2), 80.0, np.float32))
    assert running.baseline == pytest.approx(0.54)


def test_right_columns_follow_and_keypoints_without_one_do_not():
    camera = CameraModel(prgbd.PinholeCamera.from_fov(100, 80, 90.0), False, 0.1, 4.0, FeatureOptions().scales(), 5)
    slam_map = Map(3, 20, camera.scales)
    k = slam_map.keyframes.grow(1)
    slam_map.keyframes.uv[k, :, 0] = [50.0, 60.0, 70.0]
    slam_map.keyframes.depth[k] = [2.0, 4.0, 8.0]
    slam_map.keyframes.u_right[k] = [47.5, 58.75, -1.0]
    set_baseline(camera, DepthOptions(trust=10.0), 0.2)
    follow_baseline(slam_map, camera)
    np.testing.assert_allclose(slam_map.keyframes.u_right[k], [45.0, 57.5, -1.0])
    assert (camera.close_depth, camera.trusted_depth) == (8.0, 2.0)


@pytest.mark.parametrize("realtime", [False, True])
def test_a_run_without_a_baseline_ends_near_one_that_knew_it(realtime):
    sequence = prgbd.make_data("synthetic", scene="indoor", frames=20, width=320, height=240, sensor_depth=True)
    largest = max(float(sequence.depth(i).max()) for i in range(len(sequence)))
    with prgbd.make_slam("orb_gtsam", realtime=realtime) as slam:
        slam.reset(sequence.camera, "pseudo_rgbd", fps=10.0)
        for i in range(len(sequence)):
            slam.track(sequence.frame(i))
        result = slam.finish()
    assert result.tracked_frames == 20
    assert 0.95 * 0.54 / 80 * largest <= result.stats["baseline"] <= 1.001 * 0.54 / 80 * largest
    moved = np.linalg.norm(result.trajectory.positions[-1] - result.trajectory.positions[0])
    true = np.linalg.norm(sequence.poses[-1][:3, 3] - sequence.poses[0][:3, 3])
    assert moved == pytest.approx(true, rel=0.05)


def test_a_sensor_must_know_its_baseline():
    with prgbd.make_slam("orb_gtsam") as slam, pytest.raises(ConfigError, match="baseline"):
        slam.reset(prgbd.PinholeCamera.from_fov(320, 240, 60.0), "rgbd")
