"""``data=video`` from the command line: a file and a field of view are all that is given."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

import prgbd
from prgbd.evaluation.trajectory import evaluate_trajectory

FRAMES = 36
FIELD_OF_VIEW = 81.6  # degrees: 1241 pixels at f = 718.856


@pytest.fixture
def drive(shared_data: Path, tmp_path: Path):
    """An MP4 of the first frames of KITTI 00, and the recording itself for its true poses."""
    root = shared_data / "kitti_odometry"
    if not (root / "sequences/00/image_0/000000.png").is_file():
        pytest.skip("KITTI 00 is not at hand")
    recording = prgbd.make_data("kitti_odometry", root=root, sequence="00", stop=FRAMES)
    path = tmp_path / "drive.mp4"
    size = (recording.camera.width, recording.camera.height)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, size)
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write videos")
    for i in range(FRAMES):
        writer.write(recording.frame(i).image[..., ::-1])
    writer.release()
    return path, recording


@pytest.mark.slow
@pytest.mark.usefixtures("real_report")
def test_a_film_of_a_drive_gives_a_trajectory_and_a_report(cli, drive):
    path, recording = drive
    answer = cli(
        "slam=orb_gtsam", "task=slam", "data=video", f"data.root={path}", f"data.fov={FIELD_OF_VIEW}", "out=run"
    )
    assert answer.code == 0, answer.err
    assert Path("run/report.html").stat().st_size > 10_000
    result = prgbd.load_result("run/loops/00/slam/drive")
    assert result.mode == "mono"
    assert result.tracked_frames >= 0.9 * FRAMES
    figures = evaluate_trajectory(result.trajectory, FRAMES, recording.poses, recording.timestamps, alignment="sim3")
    assert figures["ate_rmse"] < 0.3  # metres, over a drive of 28
