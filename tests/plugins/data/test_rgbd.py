"""Recordings of anybody's colour and depth camera."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

import prgbd
from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data.rgbd import RgbdSequence
from tests.contracts import SequenceContract
from tests.plugins.data.warping import warp_error
from tests.plugins.data.written import picture, views_of_room, write_depth, write_image, write_picture

CAMERA = "camera: {width: 64, height: 48, fx: 50, fy: 50, cx: 31.5, cy: 23.5}\n"
START = 1305031229.5


def write(folder: Path, frames: int = 5, rgb: str = "rgb/{:06d}.png", depth: str = "depth/{:06d}.png") -> Path:
    for i in range(frames):
        write_picture(folder / rgb.format(i), i)
        write_depth(folder / depth.format(i), np.full((48, 64), 1000 * (i + 1)))
    (folder / "camera.yaml").write_text(CAMERA)
    return folder


def depths(sequence: RgbdSequence) -> list[float]:
    return [float(sequence.frame(i).depth[5, 5]) for i in range(len(sequence))]


class TestContract(SequenceContract):
    @pytest.fixture
    def sequence(self, tmp_path: Path) -> RgbdSequence:
        return RgbdSequence(write(tmp_path / "desk"))


@pytest.mark.parametrize(
    ("rgb", "depth", "options"),
    [
        ("rgb/{:06d}.png", "depth/{:d}.png", {}),
        ("rgb/{:06d}.jpg", "depth/{:06d}.tiff", {}),
        ("frame-{:06d}.color.png", "frame-{:06d}.depth.png", {"rgb": "*.color.png", "depth": "*.depth.png"}),
        ("colour/{:06d}.png", "range/{:06d}.png", {"rgb": "colour", "depth": "range"}),
    ],
)
def test_equal_numbers_find_each_other(tmp_path, rgb, depth, options):
    sequence = prgbd.make_data("rgbd", root=write(tmp_path / "desk", rgb=rgb, depth=depth), **options)
    assert (sequence.name, len(sequence)) == ("desk", 5)
    assert depths(sequence) == [1, 2, pytest.approx(3), 4, 5]
    assert sequence.fps == pytest.approx(30)
    assert sequence.poses is None
    if rgb.endswith(".png"):
        np.testing.assert_array_equal(sequence.frame(2).image, picture(2))


def test_lists_of_times_and_true_poses_on_another_clock(tmp_path, caplog):
    folder = write(tmp_path / "desk", depth="depth/{:06d}.png")
    lines = {"rgb": [], "depth": [], "groundtruth": []}
    for i in range(5):
        time = START + i / 30
        lines["rgb"].append(f"{time:.6f} rgb/{i:06d}.png")
        lines["depth"].append(f"{round((time + 0.004) * 1e9)} depth/{4 - i:06d}.png")
        lines["groundtruth"].append(f"{i / 30:.6f} {i} 0 0 0 0 0 1")
    for name, text in lines.items():
        (folder / f"{name}.txt").write_text("\n".join(text), encoding="utf-8-sig")
    with caplog.at_level(logging.WARNING, "prgbd"):
        sequence = RgbdSequence(folder)
    assert "look like nanoseconds" in caplog.text
    assert "look like seconds from the start" in caplog.text
    assert depths(sequence) == [5, 4, pytest.approx(3), 2, 1]
    np.testing.assert_allclose(sequence.poses[:, 0, 3], range(5), atol=1e-4)


@pytest.mark.parametrize("line", ["{0} rgb/{1} {0} depth/{2}", "{0} depth/{2} {0} rgb/{1}"])
def test_a_list_of_pairs(tmp_path, line):
    folder = write(tmp_path / "desk")
    text = [line.format(START + i / 10, f"{i:06d}.png", f"{4 - i:06d}.png") for i in range(4)]
    (folder / "associations.txt").write_text("\n".join(text))
    sequence = RgbdSequence(folder)
    assert sequence.fps == pytest.approx(10)
    assert depths(sequence) == [5, 4, pytest.approx(3), 2]


def test_order_is_taken_where_counts_are_equal_and_said(tmp_path, caplog):
    folder = write(tmp_path / "desk", rgb="rgb/a{:d}.png", depth="depth/b{:03d}.png")
    for path in sorted((folder / "depth").iterdir(), reverse=True):
        path.rename(path.with_name(f"{path.stem}-9.png"))
    with caplog.at_level(logging.WARNING, "prgbd"):
        assert depths(RgbdSequence(folder)) == [1, 2, pytest.approx(3), 4, 5]
    assert "paired by their order alone" in caplog.text
    next((folder / "depth").iterdir()).unlink()
    with pytest.raises(DataError, match="5 colour images and 4 depth files without common names"):
        RgbdSequence(folder)


def test_a_few_depth_images_are_said_and_none_refused(tmp_path, caplog):
    folder = write(tmp_path / "desk")
    for i in (0, 2, 4):
        (folder / "depth" / f"{i:06d}.png").unlink()
    with caplog.at_level(logging.WARNING, "prgbd"):
        assert depths(RgbdSequence(folder)) == [0, 2, 0, 4, 0]
    assert "Only 2 of the 5" in caplog.text
    for name, shift in (("rgb", 0), ("depth", 50)):
        lines = [f"{START + shift + i / 30:.6f} {name}/{i:06d}.png" for i in (1, 3)]
        (folder / f"{name}.txt").write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"do not meet"):
        RgbdSequence(folder)


def test_several_recordings_may_share_a_camera_file(tmp_path):
    for name in ("one", "two"):
        write(tmp_path / name).joinpath("camera.yaml").unlink()
    (tmp_path / "camera.yaml").write_text(CAMERA)
    assert RgbdSequence.available(root=tmp_path) == ["one", "two"]
    assert RgbdSequence(tmp_path, "two").camera.fx == 50


def test_bad_input_is_named(tmp_path):
    folder = write(tmp_path / "desk")
    with pytest.raises(DataError, match=r"data\.rgb"):
        RgbdSequence(folder, rgb="colour")
    with pytest.raises(DataError, match=r"range; check data\.rgb and data\.depth"):
        RgbdSequence(folder, depth="range")
    with pytest.raises(ConfigError, match="no folder or pattern"):
        RgbdSequence(folder, rgb="/etc")
    with pytest.raises(ConfigError, match="do you mean 1000"):
        RgbdSequence(folder, depth_levels_per_metre=0.001)
    with pytest.raises(ConfigError, match="must be a positive number"):
        prgbd.make_data("rgbd", root=folder, fps=0)
    (folder / "associations.txt").write_text("1 rgb/000000.png\n")
    with pytest.raises(DataError, match=r"Line 1 of .*associations\.txt"):
        RgbdSequence(folder)


def test_a_rendered_recording_fits_its_own_depth_and_poses(tmp_path):
    lines = []
    for i, (image, depth, wTc) in enumerate(views_of_room(prgbd.PinholeCamera(320, 240, 260, 260, 159.5, 119.5))):
        write_image(tmp_path / "rgb" / f"{START + i / 30:.6f}.png", image)
        (tmp_path / "depth").mkdir(exist_ok=True)
        np.save(tmp_path / "depth" / f"{START + i / 30 + 0.003:.6f}.npy", depth)
        lines.append([START + i / 30, *wTc[:3, 3], *quaternion(wTc)])
    np.savetxt(tmp_path / "groundtruth.txt", lines, fmt="%.6f")
    camera = {"width": 320, "height": 240, "fx": 260, "fy": 260, "cx": 159.5, "cy": 119.5}
    sequence = RgbdSequence(tmp_path, camera=camera)
    assert warp_error(sequence, 0, 1) < 0.3 * warp_error(sequence, 0, 1, identity=True)


def quaternion(wTc: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(wTc[:3, :3]).as_quat()
