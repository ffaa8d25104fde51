"""Depth images of a sensor, as many programs write them."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data._depth_files import DepthFormat, DepthReader
from tests.plugins.data.written import write_depth, write_picture

SIZE = (64, 48)


def read(path: Path, levels_per_metre: float | None = None, invalid: tuple[float, ...] = (0,)) -> np.ndarray:
    depth = DepthReader("room", SIZE, DepthFormat(levels_per_metre, invalid)).read(path)
    assert depth.dtype == np.float32
    assert depth.shape == (48, 64)
    return depth


def some(kind: type, value: float = 2) -> np.ndarray:
    return np.linspace(value, 2 * value, 48 * 64).reshape(48, 64).astype(kind)


@pytest.mark.parametrize(
    ("name", "kind", "levels"),
    [("d.png", np.uint16, 2000), ("d.tiff", np.float32, 2), ("d.tif", np.uint16, 2000), ("d.tiff", np.int32, 2000)],
)
def test_images_of_whole_numbers_are_millimetres_and_others_metres(tmp_path, name, kind, levels):
    assert cv2.imwrite(str(tmp_path / name), some(kind, levels))
    np.testing.assert_allclose(read(tmp_path / name), some(float), atol=1e-3)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64, np.uint16, np.int64])
@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 1), (1, 48, 64)])
def test_arrays(tmp_path, kind, shape):
    np.save(tmp_path / "d.npy", some(kind, 2000).reshape(shape))
    np.testing.assert_allclose(read(tmp_path / "d.npy", 1000), some(float), rtol=1e-3)


@pytest.mark.parametrize("channel", ["Y", "Z", "R"])
def test_exr(tmp_path, channel):
    exr = pytest.importorskip("OpenEXR")
    exr.File({"type": exr.scanlineimage}, {channel: some(np.float32)}).write(str(tmp_path / "d.exr"))
    np.testing.assert_allclose(read(tmp_path / "d.exr"), some(float), rtol=1e-6)


def test_unknown_values_are_zero_and_said_once(tmp_path, caplog):
    levels = some(np.uint16, 5000)
    levels[0, :3] = 0, 65535, 7777
    reader = DepthReader("room", SIZE, DepthFormat(5000, (0, 7777)))
    path = write_depth(tmp_path / "d.png", levels)
    with caplog.at_level(logging.WARNING, "prgbd"):
        depth = [reader.read(path) for _ in range(3)][2]
    assert list(depth[0, :4]) == [0, 0, 0, pytest.approx(1, abs=1e-3)]
    assert [record.message for record in caplog.records] == [
        f"Depth of 'room': 0.0% of {path} is 65535, the largest value it can hold; taken as unknown."
    ]


def test_floats_that_are_no_depth_are_unknown(tmp_path):
    levels = some(np.float32)
    levels[0, :5] = np.nan, np.inf, -np.inf, -1, np.finfo(np.float32).max
    np.save(tmp_path / "d.npy", levels)
    depth = read(tmp_path / "d.npy")
    assert not depth[0, :5].any()
    assert (depth[1:] > 0).all()


def test_a_mark_that_nobody_named_is_said(tmp_path, caplog):
    levels = some(np.uint16, 2000)
    levels[:10] = 10000
    with caplog.at_level(logging.WARNING, "prgbd"):
        read(write_depth(tmp_path / "d.png", levels))
        assert "data.depth_invalid=[0,10000]" in caplog.text
        caplog.clear()
        read(tmp_path / "d.png", None, (0, 10000))
    assert not caplog.text


def test_another_size_is_resized_and_another_shape_refused(tmp_path, caplog):
    path = write_depth(tmp_path / "d.png", np.repeat(np.repeat([[1000, 2000], [3000, 4000]], 12, 0), 16, 1))
    with caplog.at_level(logging.WARNING, "prgbd"):
        depth = read(path)
    assert "must be registered" in caplog.text
    np.testing.assert_allclose(depth[[0, 0, -1, -1], [0, -1, 0, -1]], [1, 2, 3, 4])
    with pytest.raises(DataError, match="another aspect ratio"):
        read(write_depth(path, np.ones((48, 48))))


def test_what_is_no_depth_is_named(tmp_path):
    with pytest.raises(DataError, match="is no depth"):
        read(write_picture(tmp_path / "d.png", 1))
    cv2.imwrite(str(tmp_path / "grey.png"), some(np.uint8, 100))
    with pytest.raises(DataError, match="picture of depth"):
        read(tmp_path / "grey.png")
    np.save(tmp_path / "d.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(DataError, match="no array of numbers"):
        read(tmp_path / "d.npy")
    (tmp_path / "d.exr").write_bytes(b"hello")
    with pytest.raises(DataError, match=r"d\.exr"):
        read(tmp_path / "d.exr")


@pytest.mark.parametrize(("levels", "words"), [(0.001, "do you mean 1000"), (0.0002, "do you mean 5000")])
def test_the_inverse_of_the_unit_is_recognised(levels, words):
    with pytest.raises(ConfigError, match=words):
        DepthFormat(levels)
