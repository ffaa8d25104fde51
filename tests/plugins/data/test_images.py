"""The plug-in for folders of images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data.images import ImagesSequence
from tests.contracts import SequenceContract
from tests.plugins.data.written import cut, picture, write_depth, write_picture


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "my walk"
    for i in range(12):
        write_picture(folder / f"im{i}.png", i)
    return folder


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, root: Path) -> ImagesSequence:
        return ImagesSequence(root, fov=60)


def test_frames_in_natural_order(root: Path) -> None:
    sequence = prgbd.make_data("images", root=root, fov=90, fps=5)
    assert (sequence.name, len(sequence), sequence.fps) == ("my_walk-x23b4e087", 12, pytest.approx(5))
    assert sequence.camera.fx == pytest.approx(32)
    for i in (2, 10, 11):
        np.testing.assert_array_equal(sequence.frame(i).image, picture(i))
    assert sequence.poses is None
    assert sequence.frame(0).depth is None
    part = ImagesSequence(root, fov=90, start=4, stop=9, step=2)
    assert [part.frame(i).image[0, 0, 0] for i in range(3)] == [40, 60, 80]


def test_names_in_other_scripts_are_recordings_of_their_own(tmp_path: Path) -> None:
    for name in ("办公室", "走廊", "a b", "a_b"):
        write_picture(tmp_path / name / "0.png", 0)
    names = [sequence.name for sequence in prgbd.make_sequences("images", root=tmp_path, fov=60)]
    assert {"办公室", "走廊", "a_b"} < set(names)
    assert len(set(names)) == 4


def test_names_of_a_clock_give_order_and_times_whatever_the_frame_rate(tmp_path: Path, caplog) -> None:
    times = [1678886400.2, 1678886400.2333, 1678886400.26, 1678886400.3]
    for number, time in enumerate(times):
        write_picture(tmp_path / f"{time!r}.png", number)
    for fps in (None, 30):
        sequence = ImagesSequence(tmp_path, fov=60, fps=fps)
        assert [sequence.frame(i).image[0, 0, 0] for i in range(4)] == [0, 10, 20, 30]
        np.testing.assert_allclose(sequence.timestamps, times, atol=1e-6)
    assert sequence.remarks == ("times from names (Unix seconds)",)
    assert not caplog.messages
    sequence = ImagesSequence(tmp_path, fov=60, fps=5)
    assert sequence.fps == pytest.approx(5)
    assert "are times at 30 Hz, but data.fps=5 is given" in caplog.text


def test_times_come_from_a_file(root: Path) -> None:
    (root / "data.csv").write_text(
        "#timestamp [ns],filename\n1403636579763555584,im3.png\n1403636579813555456,im1.png\n"
    )
    sequence = ImagesSequence(root, fov=60, times="data.csv")
    assert [sequence.frame(i).image[0, 0, 0] for i in range(2)] == [30, 10]
    np.testing.assert_allclose(sequence.timestamps, [1403636579.763555584, 1403636579.813555456])
    with pytest.raises(ConfigError, match=r"data\.fps and data\.times both"):
        ImagesSequence(root, fov=60, times="data.csv", fps=30)


def test_grey_levels_of_12_bits_are_scaled_by_one_factor(tmp_path: Path) -> None:
    for number, top in enumerate((4000, 900)):
        write_depth(tmp_path / f"{number}.png", np.linspace(0, top, 64 * 48).reshape(48, 64))
    sequence = ImagesSequence(tmp_path, fov=60)
    assert [int(sequence.frame(i).image.max()) for i in range(2)] == [250, 56]
    assert sequence.remarks == ("images of 12 bits scaled to 8",)
    assert ImagesSequence(tmp_path, fov=60, start=1).frame(0).image.max() == 56


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["a_0003", "a_0004", "a_0008"], [0, 1, 5]),
        (["f000", "f005", "f010", "f030"], [0, 1, 2, 6]),
        (["1403636579763555584", "1403636579813555456"], [0, 1]),
        (["a1", "b1", "c1"], [0, 1, 2]),
        (["one", "two"], [0, 1]),
    ],
)
def test_a_gap_in_the_numbers_is_a_gap_in_time(tmp_path: Path, names: list[str], times: list[float]) -> None:
    for number, name in enumerate(names):
        write_picture(tmp_path / f"{name}.png", number)
    scale = float(np.median(np.diff(times)))
    np.testing.assert_allclose(ImagesSequence(tmp_path, fov=60, fps=1).timestamps, np.array(times) / scale)


def test_the_camera_file_beside_the_images_is_found(root: Path) -> None:
    (root / "camera.yaml").write_text("camera: {fx: 70, fy: 71, cx: 30, cy: 22, distortion: [0.2, 0, 0, 0]}")
    sequence = ImagesSequence(root)
    assert (sequence.camera.fx, sequence.camera.distortion) == (70, ())
    assert np.abs(sequence.frame(1).image.astype(int) - picture(1)).max() > 3
    assert ImagesSequence(root, fov=90).camera.fx == pytest.approx(32)


def test_folders_within_are_sequences(root: Path) -> None:
    write_picture(root.parent / "second" / "a.png", 1)
    (root.parent / "empty").mkdir()
    assert ImagesSequence.available(root=root.parent) == ["my walk", "second"]
    assert ImagesSequence.available(root=root) == [None]
    assert len(ImagesSequence(root.parent, "my walk", fov=60)) == 12
    both = prgbd.make_sequences("images", root=root.parent, fov=60)
    assert [s.name for s in both] == ["my_walk-x23b4e087", "second"]
    with pytest.raises(DataError, match="choose from my walk, second"):
        ImagesSequence(root.parent, fov=60)


def test_bad_input_is_named(root: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"camera of .* is not known"):
        ImagesSequence(root)
    with pytest.raises(ConfigError, match=r"data\.fps is 0"):
        ImagesSequence(root, fov=60, fps=0)
    with pytest.raises(ConfigError, match="leaves none of the 12 frames"):
        ImagesSequence(root, fov=60, start=12)
    with pytest.raises(DataError, match="There is no folder"):
        ImagesSequence(root / "absent", fov=60)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="has no images"):
        ImagesSequence(tmp_path / "empty", fov=60)
    cut(root / "im4.png")
    with pytest.raises(DataError, match=r"im4\.png is truncated"):
        ImagesSequence(root, fov=60).frame(4)
    write_picture(root / "im5.png", 5, 32, 32)
    with pytest.raises(DataError, match=r"im5\.png is 32x32 pixels"):
        ImagesSequence(root, fov=60).frame(5)
