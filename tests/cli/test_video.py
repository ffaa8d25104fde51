"""``data=video`` from the command line: a file and a field of view are all that is given."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import prgbd
from prgbd.evaluation.trajectory import evaluate_trajectory

FRAMES = 36


@pytest.fixture(params=["rendered", pytest.param("kitti", marks=pytest.mark.shared)])
def drive(request, tmp_path: Path):
    """An MP4 of a rendered street or, with ../shared, of KITTI 00, and the recording itself for camera and truth."""
    if request.param == "kitti":
        root = request.getfixturevalue("shared_data")("kitti_odometry")
        recording = prgbd.make_data("kitti_odometry", root=root, sequence="00", stop=FRAMES)
    else:
        recording = prgbd.make_data("synthetic", sequence="street-0", frames=FRAMES)
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
    field_of_view = np.degrees(2 * np.arctan(recording.camera.width / 2 / recording.camera.fx))
    answer = cli(
        "slam=orb_gtsam", "task=slam", "data=video", f"data.root={path}", f"data.fov={field_of_view:.1f}", "out=run"
    )
    assert answer.code == 0, answer.err
    assert Path("run/report.html").stat().st_size > 10_000
    result = prgbd.load_result("run/loops/00/slam/drive")
    assert result.mode == "mono"
    assert result.tracked_frames >= 0.9 * FRAMES
    figures = evaluate_trajectory(result.trajectory, FRAMES, recording.poses, recording.timestamps, alignment="sim3")
    assert figures["ate_rmse"] < 0.3  # metres, over a drive of 28
