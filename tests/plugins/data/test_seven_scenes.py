"""The 7-Scenes plug-in on written and on real recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import PinholeCamera
from prgbd.plugins.data.seven_scenes import SevenScenesSequence
from tests.contracts import SequenceContract
from tests.plugins.data.warping import warp_error
from tests.plugins.data.written import cut, picture, turn, views_of_room, write_depth, write_image, write_picture


def write_recording(folder: Path, frames: int = 4, suffix: str = "png") -> None:
    for i in range(frames):
        write_picture(folder / f"frame-{i:06d}.color.{suffix}", i)
        levels = np.full((48, 64), 1000 + i)
        levels[0, :2] = 0, 65535
        write_depth(folder / f"frame-{i:06d}.depth.png", levels)
        pose = np.eye(4)
        pose[:3, :3], pose[0, 3] = turn(5 * i), 0.1 * i
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", pose)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    write_recording(tmp_path / "redkitchen" / "seq-01")
    return tmp_path


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, root: Path) -> SevenScenesSequence:
        return SevenScenesSequence(root, focal=50)


def test_frames_depth_and_poses(root: Path) -> None:
    sequence = prgbd.make_data("seven_scenes", root=root, sequence="redkitchen/seq-01", focal=50)
    assert (sequence.name, len(sequence)) == ("redkitchen_seq-01", 4)
    assert sequence.fps == pytest.approx(30)
    np.testing.assert_array_equal(sequence.frame(2).image, picture(2))
    depth = sequence.frame(2).depth
    np.testing.assert_array_equal(depth, sequence.depth(2))
    assert list(depth[0, :3]) == [0, 0, pytest.approx(1.002)]
    np.testing.assert_allclose(sequence.poses[3, :3, :3], turn(15), atol=1e-6)


def test_recordings_of_a_scene_can_be_named_alone(root: Path) -> None:
    write_recording(root / "redkitchen" / "seq-02", suffix="jpg")
    assert SevenScenesSequence.available(root=root) == ["redkitchen/seq-01", "redkitchen/seq-02"]
    assert SevenScenesSequence.available(root=root / "redkitchen") == ["seq-01", "seq-02"]
    sequence = SevenScenesSequence(root / "redkitchen", "seq-02", focal=50)
    assert sequence.name == "redkitchen_seq-02"
    with pytest.raises(DataError, match="choose from redkitchen/seq-01, redkitchen/seq-02"):
        SevenScenesSequence(root)
    with pytest.raises(DataError, match="no sequence 'chess/seq-01'"):
        SevenScenesSequence(root, "chess/seq-01")


def test_unknown_poses_and_missing_depth_are_unknown(root: Path) -> None:
    folder = root / "redkitchen" / "seq-01"
    (folder / "frame-000001.pose.txt").write_text("-1.#IND 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1")
    (folder / "frame-000002.pose.txt").unlink()
    (folder / "frame-000003.depth.png").unlink()
    sequence = SevenScenesSequence(root, focal=50)
    assert list(np.isfinite(sequence.poses).all(axis=(1, 2))) == [True, False, False, True]
    assert sequence.depth(3) is None
    assert (sequence.frame(3).depth == 0).all()


def test_bad_input_is_named(root: Path) -> None:
    folder = root / "redkitchen" / "seq-01"
    with pytest.raises(ConfigError, match="focal=0"):
        SevenScenesSequence(root, focal=0)
    with pytest.raises(DataError, match="There is no folder"):
        SevenScenesSequence(root / "absent")
    with pytest.raises(DataError, match="no folder SCENE/seq-XX"):
        SevenScenesSequence(folder)
    cut(folder / "frame-000001.depth.png")
    with pytest.raises(DataError, match=r"frame-000001\.depth\.png is truncated"):
        SevenScenesSequence(root, focal=50).frame(1)
    (folder / "frame-000002.pose.txt").write_text("1 2 3")
    with pytest.raises(DataError, match=r"frame-000002\.pose\.txt is not a 4x4 matrix"):
        SevenScenesSequence(root, focal=50)
    (folder / "frame-000002.pose.txt").write_text(" ".join(["2"] * 16))
    with pytest.raises(DataError, match=r"frame-000002\.pose\.txt is no rigid transform"):
        SevenScenesSequence(root, focal=50)
    for path in folder.glob("*.color.png"):
        path.unlink()
    with pytest.raises(DataError, match="has no images"):
        SevenScenesSequence(root, focal=50)


def test_the_real_recording_fits_its_own_depth_and_poses(shared_data) -> None:
    """Needs ../shared; without it the rendered recording of the next test stands in."""
    sequence = prgbd.make_data("seven_scenes", root=shared_data("seven_scenes"), sequence="redkitchen/seq-01")
    prgbd.check_sequence(sequence, frames=3)
    assert (sequence.camera.fx, sequence.camera.cx, len(sequence)) == (525, 320, 500)
    assert warp_error(sequence, 100, 110) < 0.6 * warp_error(sequence, 100, 110, identity=True)


def test_a_rendered_recording_fits_its_own_depth_and_poses(tmp_path: Path) -> None:
    folder = tmp_path / "room" / "seq-01"
    for i, (image, depth, wTc) in enumerate(views_of_room(PinholeCamera(640, 480, 525, 525, 320, 240))):
        write_image(folder / f"frame-{i:06d}.color.png", image)
        write_depth(folder / f"frame-{i:06d}.depth.png", np.rint(1000 * depth))
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", wTc)
    sequence = prgbd.make_data("seven_scenes", root=tmp_path)
    assert warp_error(sequence, 0, 1) < 0.3 * warp_error(sequence, 0, 1, identity=True)


def test_archives_that_are_still_packed_are_named(tmp_path: Path) -> None:
    (tmp_path / "chess").mkdir()
    (tmp_path / "chess" / "seq-02.zip").touch()
    (tmp_path / "chess" / "seq-01.zip").touch()
    with pytest.raises(DataError, match=r"SCENE/seq-XX; unpack chess/seq-01\.zip where it lies"):
        SevenScenesSequence(tmp_path)
