"""The KITTI raw plug-in on a written drive and on a real one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data.kitti_raw import KittiRawSequence
from tests.contracts import SequenceContract
from tests.plugins.data.written import HEIGHT, WIDTH, cut, write_picture

DAY = "2011_09_26"
DRIVE = f"{DAY}_drive_0007_sync"
ORIGIN = (49.0, 8.4, 115.0)
# Camera x is the velodyne's -y, camera y its -z, camera z its x.
AXES = "0 -1 0 0 0 -1 1 0 0"


def write_day(root: Path) -> None:
    day = root / DAY
    day.mkdir(parents=True)
    projections = {2: (3.0, 0.0), 3: (-24.0, 0.0), 0: (0.0, 0.0), 1: (-27.0, 0.0)}
    lines = ["calib_time: 09-Jan-2012 13:57:47", "R_rect_00: 1 0 0 0 1 0 0 0 1"]
    lines += [f"P_rect_{n:02d}: 50 0 32 {x} 0 50 24 {y} 0 0 1 0" for n, (x, y) in projections.items()]
    (day / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    (day / "calib_velo_to_cam.txt").write_text(f"calib_time: x\nR: {AXES}\nT: 0 0 -0.3\n")
    (day / "calib_imu_to_velo.txt").write_text("calib_time: x\nR: 1 0 0 0 1 0 0 0 1\nT: -0.8 0 0\n")


def write_drive(root: Path, name: str = DRIVE, frames: int = 5) -> Path:
    drive = root / DAY / name
    stamps = []
    for i in range(frames):
        for camera in ("image_02", "image_03"):
            write_picture(drive / camera / "data" / f"{i:010d}.png", i)
        write_oxts(drive / "oxts" / "data" / f"{i:010d}.txt", north=2.0 * i)
        stamps.append(f"2011-09-26 13:02:59.{900_000_000 + 1000 * i:09d}" if i == 0 else f"2011-09-26 13:03:00.{i:09d}")
    (drive / "image_02" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    # Three points: 10 m and 20 m ahead on the axis, and 5 m ahead, 1 m to the left.
    scan = np.array([[10.3, 0, 0, 0.5], [20.3, 0, 0, 0.5], [5.3, 1, 0, 0.5], [-4, 0, 0, 0.5]], np.float32)
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    scan.tofile(drive / "velodyne_points" / "data" / "0000000001.bin")
    return drive


def write_oxts(path: Path, north: float, yaw: float = np.pi / 2) -> None:
    """A car that drives north, and looks there (yaw 90 degrees from the east)."""
    latitude = ORIGIN[0] + np.degrees(north / 6378137.0)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(" ".join(map(repr, map(float, [latitude, *ORIGIN[1:], 0, 0, yaw, *[0] * 24]))))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    write_day(tmp_path)
    write_drive(tmp_path)
    return tmp_path


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, root: Path) -> KittiRawSequence:
        return KittiRawSequence(root)


def test_camera_baseline_and_time_stamps(root: Path) -> None:
    sequence = prgbd.make_data("kitti_raw", root=root)
    assert (sequence.name, len(sequence)) == (DRIVE, 5)
    assert sequence.camera == prgbd.PinholeCamera(WIDTH, HEIGHT, 50, 50, 32, 24)
    assert sequence.baseline == pytest.approx(27 / 50)
    assert sequence.frame(2).right is not None
    assert sequence.timestamps[:3] == pytest.approx([0.0, 0.1 + 1e-9, 0.1 + 2e-9], abs=1e-12)


def test_true_depth_is_the_nearest_point_and_no_sensors(root: Path) -> None:
    sequence = prgbd.make_data("kitti_raw", root=root)
    depth = sequence.depth(1)
    # Projected to camera 2 (3 / 50 m beside camera 0), rounded, and one less: pixels are counted from one.
    near = (round(32 + 3 / 10) - 1, 24 - 1)
    left = (round(32 - 50 / 5 + 3 / 5) - 1, 24 - 1)
    assert depth[near[1], near[0]] == pytest.approx(10.3)  # the point 20 m away is hidden behind it
    assert depth[left[1], left[0]] == pytest.approx(5.3)
    assert np.count_nonzero(depth) == 2
    assert sequence.depth(0) is None
    assert sequence.frame(1).depth is None
    z = prgbd.make_data("kitti_raw", root=root, truth="camera").depth(1)
    assert z[near[1], near[0]] == pytest.approx(10.0)


def test_poses_come_from_gps_and_inertia(root: Path) -> None:
    poses = prgbd.make_data("kitti_raw", root=root).poses
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(poses[:, :3, 3], [[0, 0, 2.0 * i] for i in range(5)], atol=2e-4)


def test_a_turn_of_the_car_turns_the_camera_about_its_inertial_unit(root: Path) -> None:
    write_oxts(root / DAY / DRIVE / "oxts" / "data" / "0000000001.txt", north=0.0, yaw=0.0)
    pose = prgbd.make_data("kitti_raw", root=root).poses[1]
    np.testing.assert_allclose(pose[:3, 2], [1, 0, 0], atol=1e-9)  # a quarter to the right
    unit = np.array([0.06, 0.0, -1.1])  # where it stands, as seen from the camera
    np.testing.assert_allclose(pose[:3, 3], unit - pose[:3, :3] @ unit, atol=1e-6)


def test_a_missing_oxts_file_leaves_the_pose_unknown(root: Path) -> None:
    (root / DAY / DRIVE / "oxts" / "data" / "0000000003.txt").unlink()
    poses = prgbd.make_data("kitti_raw", root=root).poses
    assert np.isnan(poses[3]).all()
    assert np.isfinite(poses[[0, 1, 2, 4]]).all()


def test_a_split_chooses_drives_frames_and_side(root: Path) -> None:
    write_drive(root, f"{DAY}_drive_0009_sync")
    split = root / "test_files.txt"
    split.write_text(
        f"{DAY}/{DRIVE} 0000000003 l\n{DAY}/{DRIVE} 1 l\n{DAY}/{DRIVE} 2 r\n{DAY}/2011_09_26_drive_0099_sync 5 l\n"
    )
    assert len(KittiRawSequence.available(root=root)) == 2
    assert KittiRawSequence.available(root=root, split=split) == [DRIVE]
    (left,) = prgbd.make_sequences("kitti_raw", root=root, split=split)
    np.testing.assert_array_equal([left.frame(i).image[0, 0, 0] for i in range(len(left))], [10, 30])
    assert left.depth(0) is not None
    right = prgbd.make_data("kitti_raw", root=root, split=split, side="right")
    assert right.frame(0).image[0, 0, 0] == 20
    assert (right.baseline, right.camera.cx) == (None, 32)


@pytest.mark.parametrize("name", [DRIVE, DRIVE.removesuffix("_sync"), f"{DAY}/{DRIVE}"])
def test_a_drive_may_be_written_in_several_ways(root: Path, name: str) -> None:
    write_drive(root, f"{DAY}_drive_0009_sync")
    assert prgbd.make_data("kitti_raw", root=root, sequence=name).name == DRIVE


def test_what_is_wrong_is_said_in_one_sentence(root: Path, tmp_path: Path) -> None:
    def refused(match: str, error: type[Exception] = DataError, **options: object) -> None:
        with pytest.raises(error, match=match):
            prgbd.make_data("kitti_raw", **{"root": root, **options}).depth(1)

    refused("side is 'up'", ConfigError, side="up")
    refused("truth is 'lidar'", ConfigError, truth="lidar")
    refused("no sequence 'x'", sequence="x")
    split = tmp_path / "split.txt"
    split.write_text("a b c d\n")
    refused("Line 1 of .*split.txt", split=split)
    split.write_text("2011_09_26/other 3 l\n")
    refused("none of the 1 drives", split=split)
    split.write_text(f"{DAY}/{DRIVE} 77 l\n")
    refused("lacks 1 of the 1 frames", split=split)
    scan = root / DAY / DRIVE / "velodyne_points" / "data" / "0000000001.bin"
    cut(scan, 0.55)
    refused("truncated or no velodyne scan")
    (root / DAY / DRIVE / "oxts" / "data" / "0000000002.txt").write_text("1 2 3")
    refused("30 numbers")
    (root / DAY / "calib_cam_to_cam.txt").write_text("P_rect_03: 1 2\n")
    refused("no line P_rect_02")
    with pytest.raises(DataError, match="has no drives"):
        KittiRawSequence.available(root=root / DAY / DRIVE)


def test_unrectified_drives_are_refused(root: Path) -> None:
    folder = root / DAY / DRIVE
    (root / DAY / f"{DAY}_drive_0009_extract" / "image_02" / "data").mkdir(parents=True)
    assert KittiRawSequence.available(root=root) == [DRIVE]
    folder.rename(folder.with_name(DRIVE.replace("_sync", "_extract")))
    with pytest.raises(DataError, match=r"_extract is not rectified.*synced\+rectified"):
        KittiRawSequence(root)


def test_a_drive_with_the_other_side_alone_says_so(root: Path) -> None:
    folder = root / DAY / DRIVE
    for name in ("image_00", "image_01", "image_03"):
        shutil.rmtree(folder / name, ignore_errors=True)
    (folder / "image_02").rename(folder / "image_03")
    with pytest.raises(DataError, match=r"right colour camera alone; set data\.side=right"):
        KittiRawSequence(root)


@pytest.mark.parametrize(("truth", "key"), [("velodyne", "velodyne_forward"), ("camera", "camera_z")])
def test_true_depth_of_a_real_frame_is_that_of_the_published_protocol(
    shared_data, shared_reference, truth, key
) -> None:
    """Needs ../shared; without it ``test_true_depth_is_the_nearest_point_and_no_sensors`` stands in."""
    expected = json.loads(shared_reference("kitti_gt_depth_reference.json").read_text())["value"][key]
    depth = prgbd.make_data("kitti_raw", root=shared_data("kitti_raw"), truth=truth).depth(0)
    valid = depth[depth > 0].astype(np.float64)
    assert (list(depth.shape), len(valid)) == (expected["shape"], expected["valid"])
    for value, name in ((valid.mean(), "mean"), (np.median(valid), "median"), (valid.max(), "max")):
        assert value == pytest.approx(expected[name], rel=1e-5)


def test_a_real_drive_keeps_the_contract(shared_data) -> None:
    """Needs ../shared; without it the written drive of ``TestContract`` stands in."""
    sequence = prgbd.make_data("kitti_raw", root=shared_data("kitti_raw"))
    prgbd.check_sequence(sequence)
    assert [sequence.depth(i) is not None for i in range(10)] == [i % 3 == 0 for i in range(10)]
