"""``python -m prgbd.tools prepare``."""

from __future__ import annotations

import pytest

from prgbd.tools.__main__ import main
from prgbd.tools.download_guides import GUIDES
from tests.plugins.data import test_euroc
from tests.plugins.data.test_kitti_raw import DAY, DRIVE, write_day, write_drive


@pytest.mark.parametrize("name", GUIDES)
def test_it_says_what_to_download_and_from_where(name, capsys) -> None:
    assert main(["prepare", name]) == 0
    out = capsys.readouterr().out
    assert GUIDES[name].page in out
    assert "download" in out


def test_a_complete_recording_is_described(tmp_path, capsys) -> None:
    write_day(tmp_path)
    write_drive(tmp_path)
    assert main(["prepare", "kitti_raw", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert f"ok   {DRIVE}: 5 frames" in out
    assert "true poses, true depth, stereo 0.54 m" in out
    assert "without" not in out.partition(DRIVE + ":")[2]


def test_a_recording_in_a_group_is_found(tmp_path, capsys) -> None:
    folder = test_euroc.write(tmp_path / "machine_hall" / "MH_01_easy")
    assert main(["prepare", "euroc", str(tmp_path)]) == 0
    assert "ok   MH_01_easy: 4 frames at 20.0 Hz, 64x48" in capsys.readouterr().out
    (folder / "mav0/state_groundtruth_estimate0/data.csv").unlink()
    assert main(["prepare", "euroc", str(tmp_path)]) == 0
    assert "without true poses: " in capsys.readouterr().out


def test_what_is_missing_is_named_and_what_is_needed_counts(tmp_path, capsys) -> None:
    write_day(tmp_path)
    drive = write_drive(tmp_path)
    (drive / "velodyne_points" / "data" / "0000000001.bin").unlink()
    (tmp_path / DAY / "calib_imu_to_velo.txt").unlink()
    assert main(["prepare", "kitti_raw", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "without scans, for true depth" in out
    assert "without calibration of the inertial unit" in out
    assert "no true poses" in out
    (tmp_path / DAY / "calib_cam_to_cam.txt").unlink()
    assert main(["prepare", "kitti_raw", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert f"MEND {DRIVE}" in out
    assert "needs calibration: " in out
    assert "1 of 1 recordings cannot be used." in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("kitti_rw",), "did you mean 'kitti_raw'"),
        (("synthetic",), "needs nothing to be downloaded"),
        (("kitti_odometry", "no_such_folder"), "no_such_folder"),
    ],
)
def test_what_cannot_be_prepared_is_answered_in_one_sentence(capsys, arguments, words) -> None:
    assert main(["prepare", *arguments]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert words in error


def test_the_real_recordings_are_all_there(shared_data, capsys) -> None:
    """Needs ../shared; without it the written drive of ``test_a_complete_recording_is_described`` stands in."""
    for name in ("kitti_raw", "tum_rgbd"):
        assert main(["prepare", name, str(shared_data(name))]) == 0
        assert "MEND" not in capsys.readouterr().out
