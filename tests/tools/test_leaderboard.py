"""Trajectories for the KITTI odometry benchmark: test sequences without truth, one file of poses each."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import prgbd
from prgbd.io.files import read_json, write_json
from prgbd.io.trajectory_files import read_kitti
from prgbd.tools.__main__ import main
from prgbd.tools.leaderboard import of_camera_0
from tests.cli import layouts
from tests.loop.fakes import STEP


@pytest.fixture(scope="module")
def kitti(tmp_path_factory):
    """The sequences 11 and 12 without poses, and 00 with."""
    root = tmp_path_factory.mktemp("kitti")
    noise = np.random.default_rng(0).integers(0, 256, (layouts.FRAMES, 64, 96, 3), np.uint8)
    poses = np.tile(np.eye(4), (layouts.FRAMES, 1, 1))
    poses[:, 0, 3] = 3.0 * np.arange(layouts.FRAMES)
    images = [layouts.png(pixels) for pixels in noise]
    camera = prgbd.PinholeCamera(96, 64, 80.0, 80.0, 47.5, 31.5)
    layouts.write_kitti_odometry(root, layouts.Rendered(images, [], poses, camera), ["00", "11", "12"])
    for name in ("11", "12"):
        (root / "poses" / f"{name}.txt").unlink()
    return root


@pytest.fixture
def ran(cli, kitti):
    def call(*arguments):
        answer = cli("slam=test/sideways", "data=kitti_odometry", f"data.root={kitti}", "out=run", *arguments)
        assert answer.code == 0, answer.err

    return call


MONO = ("task=slam", "slam.mode=mono", "slam.noise=0.0")


def test_test_sequences_without_truth_are_evaluated_by_the_benchmark_alone(ran, capfd):
    ran(*MONO, "data.sequences=[11,12]")
    assert read_json("run/summary.json")["loops"][0]["pose"]["11"]["ate_rmse"] is None
    assert main(["leaderboard", "run", "upload", "--scale", "2.5"]) == 0
    assert "11.txt: 6 poses, scale 2.5" in capfd.readouterr().out
    assert sorted(path.name for path in Path("upload").iterdir()) == ["11.txt", "12.txt"]
    poses = read_kitti("upload/12.txt").wTc
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(poses[:, 0, 3], 2.5 * STEP * np.arange(layouts.FRAMES), atol=1e-6)
    assert all(len(line.split()) == 12 for line in Path("upload/11.txt").read_text().splitlines())


def test_the_scale_comes_from_recordings_with_truth_and_the_kept_loop_is_taken(ran, capfd):
    loop = ("depth=test/tiny", "task.max_loops=1", "training.batch_size=4")
    ran(*loop, "data.sequences=[00]", "data.test_sequences=[11]")
    summary = read_json("run/summary.json")
    kept = summary["stop"]["best_loop"]
    assert main(["leaderboard", "run", "--scale", "truth"]) == 0
    assert [path.name for path in Path("run/leaderboard").iterdir()] == ["11.txt"]
    factor = summary["loops"][kept]["pose"]["00"]["scale"]
    expected = read_kitti(f"run/loops/{kept:02d}/slam/11/trajectory.kitti").wTc
    expected = np.linalg.inv(expected[0]) @ expected
    found = read_kitti("run/leaderboard/11.txt").wTc
    np.testing.assert_allclose(found[:, :3, 3], factor * expected[:, :3, 3], atol=1e-5)


def test_poses_of_the_colour_camera_become_those_of_camera_0():
    """Both cameras see one world point; the poses of either must take it to the same place of the first camera 0."""
    c0Tc = np.eye(4)
    c0Tc[:3, 3] = 0.06, 0.001, 0.003
    w0Tc0 = np.tile(np.eye(4), (3, 1, 1))
    w0Tc0[:, :3, :3] = Rotation.from_euler("y", [[10], [40], [90]], degrees=True).as_matrix()
    w0Tc0[:, :3, 3] = [[1, 2, 3], [4, 2, 5], [9, 2, 8]]
    colour = w0Tc0 @ c0Tc
    np.testing.assert_allclose(of_camera_0(colour, c0Tc, 1.0), np.linalg.inv(w0Tc0[0]) @ w0Tc0, atol=1e-12)
    shrunk = colour.copy()
    shrunk[:, :3, 3] /= 4
    np.testing.assert_allclose(of_camera_0(shrunk, c0Tc, 4.0), np.linalg.inv(w0Tc0[0]) @ w0Tc0, atol=1e-12)


def test_what_cannot_be_submitted_is_said(ran, capfd, tmp_path):
    def said(*arguments):
        assert main(["leaderboard", *arguments]) == 2
        return capfd.readouterr().err

    ran(*MONO, "data.sequences=[11]", "data.stop=4")
    assert "4 of the 6 frames of sequence 11" in said("run")
    assert "no recording of run has true poses" in said("run", "--scale", "truth").replace("No ", "no ")
    for wrong in ("-1", "nan", "metric"):
        assert f"--scale is '{wrong}'" in said("run", "--scale", wrong)
    shutil.rmtree("run/loops")
    assert "no trajectory of sequence 11" in said("run")
    write_json(Path("run/summary.json"), {"data": "kitti_odometry", "loops": []})
    assert "resume=run" in said("run")
    write_json(Path("run/summary.json"), {"data": "tum_rgbd", "loops": []})
    assert "tum_rgbd" in said("run")
    assert "no run folder" in said("nowhere")
