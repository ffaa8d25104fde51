"""The KITTI odometry plug-in on written and on real recordings."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data.kitti_odometry import KittiOdometrySequence
from tests.contracts import SequenceContract
from tests.plugins.data.written import cut, picture, turn, write_picture

CALIBRATION = {
    "P0": [50, 0, 32, 0, 0, 50, 24, 0, 0, 0, 1, 0],
    "P1": [50, 0, 32, -25, 0, 50, 24, 0, 0, 0, 1, 0],
    "P2": [50, 0, 32, 3.0, 0, 50, 24, 0.5, 0, 0, 1, 0.02],
    "P3": [50, 0, 32, -24.0, 0, 50, 24, 0.5, 0, 0, 1, 0.02],
}


def write_calibration(path: Path, **changes: object) -> None:
    lines = {**CALIBRATION, **changes}
    path.write_text("".join(f"{k}: {' '.join(map(str, v))}\n" for k, v in lines.items() if v is not None))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A sequence 04 of 5 grey-camera frames, the first two with a right image, and poses that turn and move."""
    folder = tmp_path / "sequences" / "04"
    for i in range(5):
        write_picture(folder / "image_0" / f"{i:06d}.png", i)
        if i < 2:
            write_picture(folder / "image_1" / f"{i:06d}.png", 20 + i)
    write_calibration(folder / "calib.txt")
    (folder / "times.txt").write_text("".join(f"{0.1 * i:e}\n" for i in range(5)))
    rows = [np.hstack([turn(10 * i), [[i], [0], [2 * i]]]).ravel() for i in range(5)]
    (tmp_path / "poses").mkdir()
    np.savetxt(tmp_path / "poses" / "04.txt", rows)
    return tmp_path


def folder(root: Path) -> Path:
    return root / "sequences" / "04"


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, root: Path) -> KittiOdometrySequence:
        return KittiOdometrySequence(root)


def test_frames_poses_and_baseline(root: Path) -> None:
    sequence = prgbd.make_data("kitti_odometry", root=root, sequence=4)
    assert (sequence.name, len(sequence), sequence.baseline) == ("04", 5, pytest.approx(0.5))
    assert sequence.camera == prgbd.PinholeCamera(64, 48, 50, 50, 32, 24)
    np.testing.assert_array_equal(sequence.frame(3).image, picture(3))
    np.testing.assert_array_equal(sequence.frame(1).right, picture(21))
    assert sequence.frame(2).right is None
    np.testing.assert_allclose(sequence.poses[3, :3, 3], [3, 0, 6])
    assert sequence.depth(0) is None


def test_the_colour_camera_is_preferred_and_its_offset_is_in_the_poses(root: Path) -> None:
    shutil.copytree(folder(root) / "image_0", folder(root) / "image_2")
    shutil.copytree(folder(root) / "image_1", folder(root) / "image_3")
    colour, grey = KittiOdometrySequence(root), KittiOdometrySequence(root, camera="gray")
    assert colour.baseline == pytest.approx(27 / 50)
    # A world point has the pixel that P2 gives it from camera 0, and that the colour pose and K give it.
    point = np.array([1.0, -0.5, 12.0])
    in_zero = np.linalg.inv(grey.poses[2]) @ np.append(point, 1)
    pixel = np.reshape(CALIBRATION["P2"], (3, 4)) @ in_zero
    in_colour = (np.linalg.inv(colour.poses[2]) @ np.append(point, 1))[:3]
    np.testing.assert_allclose(colour.camera.project(in_colour[None])[0], pixel[:2] / pixel[2], atol=1e-9)
    np.testing.assert_allclose(grey.poses[0], np.eye(4), atol=1e-12)


def test_a_range_of_frames_keeps_everything_together(root: Path) -> None:
    sequence = KittiOdometrySequence(root, start=1, stop=5, step=2)
    assert len(sequence) == 2
    np.testing.assert_allclose(sequence.timestamps, [0.1, 0.3])
    np.testing.assert_array_equal(sequence.frame(1).image, picture(3))
    assert sequence.poses[1, 0, 3] == 3
    assert sequence.frame(0).right is not None


def test_images_belong_to_the_times_and_poses_of_their_numbers(root: Path) -> None:
    (folder(root) / "image_0" / "000001.png").unlink()
    sequence = KittiOdometrySequence(root)
    np.testing.assert_allclose(sequence.timestamps, [0, 0.2, 0.3, 0.4])
    assert sequence.poses[1, 0, 3] == 2


def test_without_poses_there_are_none(root: Path) -> None:
    (root / "poses" / "04.txt").unlink()
    assert KittiOdometrySequence(root).poses is None


def test_available(root: Path) -> None:
    shutil.copytree(folder(root), root / "sequences" / "11")
    (root / "sequences" / "empty").mkdir()
    assert KittiOdometrySequence.available(root=root) == ["04", "11"]
    with pytest.raises(DataError, match="holds 2 sequences; choose from 04, 11"):
        KittiOdometrySequence(root)
    with pytest.raises(DataError, match=r"no sequence '07' .* there are 04, 11"):
        KittiOdometrySequence(root, "07")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"P0": None}, "calib.txt has no line P0"),
        ({"P0": [50, 0, 32]}, "line P0 .* not 12 finite numbers"),
        ({"P0": ["x"] * 12}, "line P0 .* not 12 finite numbers"),
        ({"P0": [float("nan")] * 12}, "line P0 .* not 12 finite numbers"),
        ({"P0": [0] * 12}, "focal length that is not positive"),
        ({"P0": [700, 0, 600, 0, 0, 700, 180, 0, 0, 0, 1, 0]}, "outside the 64x48 images"),
        ({"P1": None}, "no line P1"),
        ({"P1": [50, 0, 32, 25, 0, 50, 24, 0, 0, 0, 1, 0]}, "-0.5 m right"),
    ],
)
def test_a_wrong_calibration_is_refused(root: Path, changes: dict, message: str) -> None:
    write_calibration(folder(root) / "calib.txt", **changes)
    with pytest.raises(DataError, match=message):
        KittiOdometrySequence(root)


def test_missing_and_broken_files_are_named(root: Path) -> None:
    with pytest.raises(DataError, match=r"There is no folder .*absent"):
        KittiOdometrySequence(root / "absent")
    with pytest.raises(DataError, match="has no folder 'sequences'"):
        KittiOdometrySequence(folder(root))
    with pytest.raises(ConfigError, match="camera is 'infrared'"):
        KittiOdometrySequence(root, camera="infrared")
    cut(folder(root) / "image_0" / "000003.png")
    with pytest.raises(DataError, match=r"000003\.png is truncated"):
        KittiOdometrySequence(root).frame(3)
    write_picture(folder(root) / "image_0" / "000003.png", 3, 32, 24)
    with pytest.raises(DataError, match=r"000003\.png is 32x24"):
        KittiOdometrySequence(root).frame(3)
    for name in ("times.txt", "calib.txt"):
        (folder(root) / name).unlink()
        with pytest.raises(DataError, match=rf"There is no file .*{name}; .*data_odometry_calib\.zip"):
            KittiOdometrySequence(root)


def test_an_empty_folder_of_images_is_refused(root: Path) -> None:
    for path in (folder(root) / "image_0").iterdir():
        path.unlink()
    with pytest.raises(DataError, match="image_0 has no images"):
        KittiOdometrySequence(root)


def test_times_and_poses_must_fit_the_images(root: Path) -> None:
    poses, times = root / "poses" / "04.txt", folder(root) / "times.txt"
    lines = poses.read_text().splitlines()
    poses.write_text("\n".join(lines[:4]))
    with pytest.raises(DataError, match=r"4 poses, but times\.txt has 5"):
        KittiOdometrySequence(root)
    poses.write_text("\n".join([*lines[:4], "1 2 3"]))
    with pytest.raises(DataError, match=r"Line 5 of .*04\.txt is not 12 numbers"):
        KittiOdometrySequence(root)
    poses.unlink()
    times.write_text("0\n0.1\n")
    with pytest.raises(DataError, match="has 2 time stamps"):
        KittiOdometrySequence(root)
    times.write_text("0\n0.1\n0.1\n0.2\n0.3\n")
    with pytest.raises(DataError, match="do not ascend"):
        KittiOdometrySequence(root)


def test_the_real_sequence(shared_data) -> None:
    """Needs ../shared; without it ``test_frames_poses_and_baseline`` and ``TestContract`` stand in."""
    sequence = prgbd.make_data("kitti_odometry", root=shared_data("kitti_odometry"), sequence="00")
    prgbd.check_sequence(sequence)
    assert (sequence.camera.width, sequence.camera.height) == (1241, 376)
    assert sequence.baseline == pytest.approx(0.537, abs=1e-3)
    assert len(sequence) >= 200
    assert sequence.frame(5).right is not None
    assert np.linalg.norm(np.diff(sequence.poses[:200, :3, 3], axis=0), axis=1).sum() == pytest.approx(145, abs=5)
