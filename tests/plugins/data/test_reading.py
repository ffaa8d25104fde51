"""Reading of single images and camera files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import PinholeCamera
from prgbd.core.undistortion import Undistorter
from prgbd.plugins.data._camera import make_camera
from prgbd.plugins.data._images import common_levels, list_images, read_image
from prgbd.plugins.data._recording import as_poses, frame_range
from tests.plugins.data.written import cut, picture, write_depth, write_picture


def test_images_are_rgb_and_contiguous(tmp_path: Path) -> None:
    image = read_image(write_picture(tmp_path / "a.png", 3))
    np.testing.assert_array_equal(image, picture(3))
    assert image.flags.c_contiguous


def test_grey_images_get_three_channels(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture(0)[..., 1])
    image = read_image(tmp_path / "a.png")
    assert image.shape == (48, 64, 3)
    np.testing.assert_array_equal(image[..., 0], image[..., 2])


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("part", [0.0, 0.3, 0.9, 0.99])
def test_truncated_images_are_refused_wherever_they_end(tmp_path: Path, suffix: str, part: float) -> None:
    # Noise, so that the file is long enough for every cut to hit its data.
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), noise)
    read_image(path)
    cut(path, part)
    with pytest.raises(DataError, match=r"a\.(png|jpg) is truncated or no image"):
        read_image(path)


def test_a_jpeg_with_bytes_after_its_end_is_read(tmp_path: Path) -> None:
    path = write_picture(tmp_path / "a.jpg", 3)
    expected, data = read_image(path), path.read_bytes()
    film = b"\0\0\0\x18ftypmp42" + np.random.default_rng(0).integers(0, 256, 5000, np.uint8).tobytes()
    for trailer in (b"\0" * 100, film, data, film + data):
        path.write_bytes(data + trailer)
        np.testing.assert_array_equal(read_image(path), expected)


def test_a_thumbnail_does_not_hide_that_a_jpeg_is_truncated(tmp_path: Path) -> None:
    path = write_picture(tmp_path / "a.jpg", 3)
    data = path.read_bytes()
    segment = b"\xff\xe1" + (len(data) + 2).to_bytes(2, "big") + data
    path.write_bytes(data[:2] + segment + data[2:])
    assert read_image(path).shape == (48, 64, 3)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(DataError, match="truncated"):
        read_image(path)


@pytest.mark.parametrize(
    ("scale", "kind", "expected"),
    [(1, np.uint16, 1), (1 / 64, np.uint16, 1), (1 / 256, np.float32, 1 / 65536), (1, np.float32, 1 / 256)],
)
def test_images_of_more_than_8_bits_fill_the_range_of_8(tmp_path: Path, scale, kind, expected) -> None:
    values = np.linspace(0, 65535, 64 * 48).reshape(48, 64)
    cv2.imwrite(str(tmp_path / "a.tiff"), (values * (scale if kind == np.uint16 else expected)).astype(kind))
    levels, _ = common_levels([tmp_path / "a.tiff"])
    image = read_image(tmp_path / "a.tiff", levels=levels)
    np.testing.assert_allclose(image[..., 0], values / 256, atol=1.01)


def test_a_thermal_camera_is_stretched_and_a_stuck_pixel_does_not_count(tmp_path: Path) -> None:
    values = np.linspace(29500, 30200, 640 * 480).reshape(480, 640)
    values[100, 100] = 65535
    write_depth(tmp_path / "a.png", values)
    levels, said = common_levels([tmp_path / "a.png"])
    assert "stretched to 8 bits, all by one factor" in said
    assert np.ptp(read_image(tmp_path / "a.png", levels=levels)[200:, :, 0]) > 60


def test_what_a_camera_notes_of_how_it_was_held_turns_the_image(tmp_path: Path) -> None:
    path = write_picture(tmp_path / "a.jpg", 3)
    data = path.read_bytes()
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:])
    assert read_image(path).shape == (64, 48, 3)


def test_what_is_no_image_or_absent_or_of_another_size_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("hello")
    with pytest.raises(DataError, match="no image"):
        read_image(tmp_path / "text.png")
    with pytest.raises(DataError, match=r"There is no file .*an image of the recording"):
        read_image(tmp_path / "absent.png")
    with pytest.raises(DataError, match="64x48 pixels, but the camera of the recording is 32x24"):
        read_image(write_picture(tmp_path / "a.png", 0), (32, 24))


def test_images_come_in_natural_order(tmp_path: Path) -> None:
    for number in (10, 9, 2, 1):
        write_picture(tmp_path / f"im{number}.png", number)
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "._im3.png").write_text("")
    assert [p.stem for p in list_images(tmp_path)] == ["im1", "im2", "im9", "im10"]


def test_a_camera_comes_from_yaml_a_mapping_or_a_field_of_view(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text("camera: {width: 64, height: 48, fx: 50, fy: 51, cx: 31, cy: 24, distortion: [0.1, 0, 0, 0]}\n")
    expected = PinholeCamera(64, 48, 50, 51, 31, 24, (0.1, 0, 0, 0))
    assert make_camera(path, None, 64, 48, tmp_path) == expected
    values = {"fx": 50, "fy": 51, "cx": 31, "cy": 24, "distortion": [0.1, 0, 0, 0]}
    assert make_camera(values, None, 64, 48, tmp_path) == expected
    path.write_text("camera:\n  fov_degrees: 90\n")
    assert make_camera(path, None, 64, 48, tmp_path) == PinholeCamera.from_fov(64, 48, 90)
    assert make_camera(None, 90, 64, 48, tmp_path) == PinholeCamera.from_fov(64, 48, 90)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("camera: {fx: 50, fy: 50, cx: 31}", "lacks cy"),
        ("camera: {fx: fifty, fy: 50, cx: 31, cy: 24}", "fx in .* is 'fifty', which is no number"),
        ("camera: {fx: .nan, fy: 50, cx: 31, cy: 24}", "not finite"),
        ("camera: {fx: -50, fy: 50, cx: 31, cy: 24}", "must be positive"),
        ("camera: {fx: 0.8, fy: 1.1, cx: 0.5, cy: 0.5}", "look normalised"),
        ("camera: {fx: 500, fy: 500, cx: 320, cy: 240}", "outside the 64x48 images"),
        ("camera: {width: 640, height: 480, fx: 500, fy: 500, cx: 320, cy: 240}", "640x480 images, but"),
        ("camera: {fx: 50, fy: 50, cx: 31, cy: 24, distortion: [1, 2]}", "has 2 numbers"),
        ("camera: {fx: 50, fy: 50, cx: 31, cy: 24, distortion: 3}", "must be a list"),
        ("camera: {fx: 50, fy: 50, cx: 31, cy: 24, focal: 3}", "unknown entry 'focal'"),
        ("[1, 2]", "holds no mapping"),
        ("", "holds no mapping"),
        ("camera: {", "no readable YAML"),
        ("camera: !!python/object/apply:os.getcwd []", "no readable YAML"),
    ],
)
def test_a_wrong_camera_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(DataError, match=message):
        make_camera(path, None, 64, 48, tmp_path)


def test_a_camera_must_be_given_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not known"):
        make_camera(None, None, 64, 48, tmp_path)
    with pytest.raises(ConfigError, match="given twice"):
        make_camera({"fov_degrees": 50}, 50, 64, 48, tmp_path)
    with pytest.raises(ConfigError, match="between 0 and 180"):
        make_camera(None, 200, 64, 48, tmp_path)
    with pytest.raises(DataError, match=r"no file .*the camera file"):
        make_camera(tmp_path / "absent.yaml", None, 64, 48, tmp_path)


def test_undistortion_brings_pixels_where_the_pinhole_camera_sees_them() -> None:
    camera = PinholeCamera(160, 120, 120, 118, 80, 58, (0.26, -0.95, -0.005, 0.003, 1.16))
    # A dot whose ray is known is drawn where the lens shows it.
    ray = np.array([[0.25, -0.2, 1.0]])
    seen = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion))[0].ravel()
    u, v = np.meshgrid(np.arange(160), np.arange(120))
    dot = np.exp(-((u - seen[0]) ** 2 + (v - seen[1]) ** 2) / 8)
    image = np.repeat((255 * dot).astype(np.uint8)[..., None], 3, axis=2)
    out = Undistorter(camera).image(image)[..., 0].astype(float)
    found = np.array([(out * u).sum(), (out * v).sum()]) / out.sum()
    np.testing.assert_allclose(found, camera.undistorted().project(ray)[0], atol=0.3)
    assert np.linalg.norm(found - seen) > 0.5


def test_depth_is_undistorted_without_new_values() -> None:
    camera = PinholeCamera(160, 120, 120, 118, 80, 58, (0.26, -0.95, -0.005, 0.003, 1.16))
    depth = np.where(np.arange(160) < 80, 1.0, 4.0).astype(np.float32) * np.ones((120, 1), np.float32)
    assert set(np.unique(Undistorter(camera).depth(depth))) <= {0.0, 1.0, 4.0}
    np.testing.assert_array_equal(Undistorter(camera.undistorted()).depth(depth), depth)


def test_ranges_of_frames() -> None:
    assert list(frame_range(10, 2, None, 3, "x")) == [2, 5, 8]
    assert list(frame_range(10, 0, 99, 4, "x")) == [0, 4, 8]
    for wrong in ((-1, None, 1), (0, None, 0), (0, -2, 1), (10, None, 1), (5, 5, 1)):
        with pytest.raises(ConfigError, match="range of frames"):
            frame_range(10, *wrong, "x")


def test_poses_are_made_orthonormal_and_others_refused() -> None:
    row = np.eye(4)[:3].reshape(1, 12)
    rounded = row + 1e-4 * np.arange(12)
    rotation = as_poses(rounded, Path("p"))[0, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    for wrong, message in ((row * np.nan, "not finite"), (row * 1.5, "no rigid"), (-row, "no rigid")):
        with pytest.raises(DataError, match=message):
            as_poses(wrong, Path("p"))
