"""The TUM RGB-D plug-in on written and on real recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data.tum_rgbd import FAMILIES, TumRgbdSequence
from tests.contracts import SequenceContract
from tests.plugins.data.warping import warp_error
from tests.plugins.data.written import cut, picture, views_of_room, write_depth, write_image, write_picture

START = 1305031229.5


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Four frames at 30 Hz, the third without depth, and a motion capture at 100 Hz that ends before the fourth."""
    folder = tmp_path / "rgbd_dataset_freiburg3_desk"
    rgb, depth = [], []
    for i in range(4):
        stamp = f"{START + i / 30:.6f}"
        write_picture(folder / "rgb" / f"{stamp}.png", i, 640, 480)
        rgb.append(f"{stamp} rgb/{stamp}.png")
        if i != 2:
            stamp = f"{START + i / 30 + 0.015:.6f}"
            write_depth(folder / "depth" / f"{stamp}.png", np.full((480, 640), 5000 * (i + 1)))
            depth.append(f"{stamp} depth/{stamp}.png")
    (folder / "rgb.txt").write_text("# color images\n# timestamp filename\n" + "\n".join(rgb))
    (folder / "depth.txt").write_text("\n".join(depth))
    truth = []
    for k in range(-1, 8):
        quaternion = Rotation.from_euler("y", 10 * k, degrees=True).as_quat()
        truth.append([START + 0.005 + 0.01 * k, k, 0, 2 * k, *quaternion])
    np.savetxt(folder / "groundtruth.txt", truth, fmt="%.6f")
    return tmp_path


def only(root: Path) -> Path:
    return next(root.iterdir())


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, root: Path) -> TumRgbdSequence:
        return TumRgbdSequence(root)


def test_frames_depth_and_interpolated_poses(root: Path) -> None:
    sequence = prgbd.make_data("tum_rgbd", root=root)
    assert (sequence.name, len(sequence)) == ("rgbd_dataset_freiburg3_desk", 4)
    assert sequence.camera.distortion == ()
    np.testing.assert_array_equal(sequence.frame(1).image, picture(1, 640, 480))
    assert sequence.depth(1)[3, 3] == pytest.approx(2)
    assert sequence.depth(2) is None
    assert (sequence.frame(2).depth == 0).all()
    known = np.isfinite(sequence.poses).all(axis=(1, 2))
    assert list(known) == [True, True, True, False]
    # At START the capture is half way between its poses -1 and 0.
    np.testing.assert_allclose(sequence.poses[0, :3, 3], [-0.5, 0, -1], atol=1e-3)
    expected = Rotation.from_euler("y", -5, degrees=True).as_matrix()
    np.testing.assert_allclose(sequence.poses[0, :3, :3], expected, atol=1e-3)


def test_the_folder_of_the_recording_itself_will_do_and_lists_may_be_absent(root: Path) -> None:
    (only(root) / "rgb.txt").unlink()
    (only(root) / "depth.txt").unlink()
    sequence = TumRgbdSequence(only(root))
    assert (sequence.name, len(sequence)) == ("rgbd_dataset_freiburg3_desk", 4)
    assert TumRgbdSequence.available(root=only(root)) == TumRgbdSequence.available(root=root) == [sequence.name]
    assert sequence.depth(0) is not None


def test_the_family_decides_the_camera(root: Path) -> None:
    desk = TumRgbdSequence(root, family="freiburg1")
    assert desk.camera.fx == pytest.approx(517.3, abs=0.01)
    # Undistortion moved the picture's ramp.
    assert np.abs(desk.frame(1).image.astype(int) - picture(1, 640, 480)).max() > 5
    only(root).rename(root / "my_desk")
    with pytest.raises(DataError, match=r"set the option data\.family"):
        TumRgbdSequence(root)
    with pytest.raises(ConfigError, match="family is 'kinect'"):
        TumRgbdSequence(root, family="kinect")
    assert TumRgbdSequence(root, family="freiburg3").name == "my_desk"


def test_without_truth_or_depth_there_is_none(root: Path) -> None:
    (only(root) / "groundtruth.txt").unlink()
    (only(root) / "depth").rename(only(root) / "elsewhere")
    sequence = TumRgbdSequence(root)
    assert sequence.poses is None
    assert sequence.frame(0).depth is None


def test_a_gap_of_the_motion_capture_is_not_bridged(root: Path) -> None:
    path = only(root) / "groundtruth.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[1], lines[-1].replace("1305031229.575", "1305031230.575")]))
    known = np.isfinite(TumRgbdSequence(root).poses).all(axis=(1, 2))
    assert list(known) == [True, False, False, False]


def test_bad_input_is_named(root: Path) -> None:
    folder = only(root)
    with pytest.raises(DataError, match="There is no folder"):
        TumRgbdSequence(root / "absent")
    with pytest.raises(DataError, match="is no recording and holds none"):
        TumRgbdSequence(folder / "rgb")
    with pytest.raises(DataError, match="no sequence 'desk'"):
        TumRgbdSequence(root, "desk")
    truth = (folder / "groundtruth.txt").read_text()
    (folder / "groundtruth.txt").write_text(truth + "1 2 3\n")
    with pytest.raises(DataError, match=r"groundtruth\.txt is not 8 numbers"):
        TumRgbdSequence(root)
    (folder / "groundtruth.txt").write_text("1 0 0 0 0 0 0 0\n2 0 0 0 0 0 0 1\n")
    with pytest.raises(DataError, match="quaternion of length 0 at time 1"):
        TumRgbdSequence(root)
    (folder / "groundtruth.txt").write_text(truth)
    images = sorted((folder / "rgb").iterdir())
    cut(images[1])
    with pytest.raises(DataError, match="is truncated"):
        TumRgbdSequence(root).frame(1)
    images[1].unlink()
    with pytest.raises(DataError, match="There is no file"):
        TumRgbdSequence(root).frame(1)
    (folder / "rgb.txt").write_text("hello\n")
    with pytest.raises(DataError, match=r"Line 1 of .*rgb\.txt"):
        TumRgbdSequence(root)
    (folder / "rgb.txt").write_text("# nothing\n")
    with pytest.raises(DataError, match="lists no images"):
        TumRgbdSequence(root)


def test_images_of_another_size_are_refused(root: Path) -> None:
    write_picture(sorted((only(root) / "rgb").iterdir())[0], 0, 320, 240)
    with pytest.raises(DataError, match="are 640x480"):
        TumRgbdSequence(root)


def test_the_real_recording_fits_its_own_depth_and_poses(shared_data) -> None:
    """Needs ../shared; without it the rendered recording of the next test stands in."""
    sequence = prgbd.make_data("tum_rgbd", root=shared_data("tum_rgbd"))
    prgbd.check_sequence(sequence, frames=3)
    assert sequence.camera.fx == pytest.approx(517.306408)
    assert np.isfinite(sequence.poses).all()
    assert warp_error(sequence, 20, 28) < 0.6 * warp_error(sequence, 20, 28, identity=True)


def test_a_rendered_recording_fits_its_own_depth_and_poses(tmp_path: Path) -> None:
    folder, truth = tmp_path / "rgbd_dataset_freiburg3_room", []
    for i, (image, depth, wTc) in enumerate(views_of_room(FAMILIES["freiburg3"])):
        stamp = f"{START + i / 30:.6f}"
        write_image(folder / "rgb" / f"{stamp}.png", image)
        write_depth(folder / "depth" / f"{stamp}.png", np.rint(5000 * depth))
        truth.append([float(stamp), *wTc[:3, 3], *Rotation.from_matrix(wTc[:3, :3]).as_quat()])
    np.savetxt(folder / "groundtruth.txt", truth, fmt="%.6f")
    sequence = prgbd.make_data("tum_rgbd", root=tmp_path)
    assert warp_error(sequence, 0, 1) < 0.3 * warp_error(sequence, 0, 1, identity=True)


def test_a_packed_recording_and_a_line_that_comes_twice_are_named(root: Path, tmp_path: Path) -> None:
    (tmp_path / "packed").mkdir()
    (tmp_path / "packed" / "rgbd_dataset_freiburg1_xyz.tgz").touch()
    with pytest.raises(DataError, match=r"unpack rgbd_dataset_freiburg1_xyz\.tgz"):
        TumRgbdSequence(tmp_path / "packed")
    listing = next(root.glob("*/rgb.txt"))
    lines = listing.read_text().splitlines()
    listing.write_text("\n".join([*lines, lines[-1]]) + "\n")
    with pytest.raises(DataError, match=rf"do not ascend behind {Path(lines[-1].split()[1]).name}"):
        TumRgbdSequence(root, listing.parent.name)
