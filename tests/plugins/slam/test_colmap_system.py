"""``slam=colmap``: offline structure from motion on small made-up recordings."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip("pycolmap", reason="slam=colmap comes with the extra 'colmap'")

import prgbd
from prgbd import make_slam
from prgbd.core.errors import ConfigError, SlamError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.evaluation.trajectory import evaluate_trajectory
from prgbd.plugins.slam.colmap import ColmapSLAM
from prgbd.plugins.slam.colmap.completion import interpolate
from prgbd.plugins.slam.colmap.reconstruction import image_name, pairs_in_order
from prgbd.plugins.slam.colmap.system import _say_what_is_left_out
from tests.contracts import SlamContract


class TestContract(SlamContract):
    @pytest.fixture
    def system(self):
        return ColmapSLAM()  # with its defaults, threads among them


@pytest.fixture(scope="module")
def slam_map():
    return prgbd.make_data("synthetic", sequence="indoor-0", frames=24, width=320, height=240)


def reconstructed(slam_map, mode, blank=(), told=None, **options):
    with prgbd.make_slam("colmap", every=2, threads=1, **options) as system:
        system.reset(slam_map.camera, mode, baseline=None if mode == "mono" else 0.08, fps=slam_map.fps)
        system.listen(told)
        for i in range(len(slam_map)):
            frame = slam_map.frame(i)
            if i in blank:
                frame = Frame(i, frame.timestamp, np.zeros_like(frame.image))
            system.track(frame.with_depth(slam_map.depth(i) if mode == "rgbd" else None))
        return system.finish()


@pytest.fixture(scope="module")
def measured(slam_map):
    """A reconstruction with depth, a frame of which is black, and what it told of its work."""
    calls = []
    result = reconstructed(slam_map, "rgbd", blank=(9,), told=lambda *call: calls.append(call))
    return result, calls


def test_depth_fixes_the_scale(slam_map, measured):
    result, _ = measured
    figures = evaluate_trajectory(
        result.trajectory, len(slam_map), slam_map.poses, slam_map.timestamps, alignment="se3"
    )
    assert result.tracked_frames == len(slam_map)
    assert figures["ate_rmse"] < 0.02
    seen = result.camera.project(
        np.einsum(
            "mij,mj->mi",
            np.linalg.inv(result.keyframes.wTc)[result.observations.keyframe],
            np.c_[result.points.xyz, np.ones(len(result.points))][result.observations.point],
        )[:, :3]
    )
    assert np.median(np.linalg.norm(seen - result.observations.uv, axis=1)) < 1.0


def test_frames_between_are_located_and_what_cannot_be_is_interpolated_and_marked(slam_map, measured):
    result, _ = measured
    keyframes = result.keyframes.frame_index.tolist()
    between = sorted({*range(len(slam_map))} - {*keyframes, 9})
    assert result.stats["located_frames"] == len(between) >= 10
    assert result.stats["interpolated_frames"] == [9]
    assert {result.states[i] for i in (*keyframes, *between)} == {"ok"}
    assert (result.states[9], result.inliers[9]) == ("interpolated", 0)
    assert result.inliers[between].min() >= 20
    # Located one by one: as near to their neighbours' truth as these are, not merely on the line between them.
    wTc, true = result.trajectory.wTc, slam_map.poses
    for i in between:
        step, truth = np.linalg.inv(wTc[i - 1]) @ wTc[i], np.linalg.inv(true[i - 1]) @ true[i]
        assert np.linalg.norm(step[:3, 3] - truth[:3, 3]) < 0.01


def test_its_work_is_told_of(measured):
    _, calls = measured
    last = {what: (done, total) for what, done, total in calls}
    assert list(last) == ["COLMAP features", "COLMAP matches", "COLMAP mapping", "Locating frames"]
    assert all(done == total > 0 for done, total in last.values())


def test_an_unknown_camera_is_estimated(slam_map):
    result = reconstructed(slam_map, "mono", intrinsics="unknown")
    assert result.camera.fx == pytest.approx(slam_map.camera.fx, rel=0.1)
    assert result.stats["camera"]["fx"] == result.camera.fx
    # The images are undistorted with what was found before anything learns from them.
    assert len(result.camera.distortion) == 4
    assert abs(result.camera.distortion[0]) < 0.05


def test_several_models_are_said(caplog):
    part = SimpleNamespace(sizes=[12, 5, 3])
    _say_what_is_left_out(part, 24)
    assert "3 unconnected models of 12, 5, 3 images" in caplog.text


def test_images_are_paired_as_colmap_does(tmp_path):
    import pycolmap

    slam_map = prgbd.make_data("synthetic", sequence="indoor-0", frames=2, width=96, height=64)
    (tmp_path / "images").mkdir()
    names = [image_name(i) for i in range(9)]
    for name in names:
        cv2.imwrite(str(tmp_path / "images" / name), slam_map.frame(0).image)
    database = pycolmap.Database.open(tmp_path / "database.db")
    pycolmap.import_images(tmp_path / "database.db", tmp_path / "images", pycolmap.CameraMode.SINGLE, names)
    options = pycolmap.SequentialPairingOptions()
    options.overlap, options.quadratic_overlap = 3, True
    theirs = pycolmap.SequentialPairGenerator(options, database).all_pairs()
    database.close()
    assert sorted((min(pair) - 1, max(pair) - 1) for pair in theirs) == pairs_in_order(9, 3)


def test_nothing_registered_is_one_sentence():
    system = ColmapSLAM(every=1, threads=1)
    system.reset(PinholeCamera.from_fov(96, 64, 60.0), "mono")
    for i in range(3):
        system.track(Frame(i, 0.1 * i, np.zeros((64, 96, 3), np.uint8)))
    folder = system._path
    with pytest.raises(SlamError, match=r"could not register any of 3 keyframes.*slam.every"):
        system.finish()
    system.close()
    assert not folder.exists()


@pytest.mark.parametrize("options", [{"every": 0}, {"intrinsics": "guess"}, {"threads": 1.5}])
def test_options_that_cannot_work_are_refused(options):
    with pytest.raises(ConfigError, match=f"slam.{next(iter(options))}"):
        make_slam("colmap", **options)


def test_poses_between_neighbours_follow_time_and_wide_gaps_stay_open():
    wTc = np.tile(np.eye(4), (3, 1, 1))
    wTc[:, 0, 3] = [0.0, 4.0, 8.0]
    stamps = np.array([0.0, 1.0, 4.0, 5.0, 6.0, 7.0, 8.0])
    frames, poses = interpolate(np.array([0, 2, 6]), wTc, stamps, gap=2)
    assert frames.tolist() == [0, 1, 2, 6]
    assert np.allclose(poses[:, 0, 3], [0.0, 1.0, 4.0, 8.0])
