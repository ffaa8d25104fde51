"""Depth files, pose files and lists of times, whatever a program or an accident wrote into them."""

from __future__ import annotations

import io
import logging
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from prgbd.core.errors import DataError
from prgbd.io.time_base import common_clock, in_seconds
from prgbd.io.trajectory_files import read_kitti, read_tum
from prgbd.plugins.data._depth_files import DepthFormat, DepthReader
from prgbd.plugins.data._rgbd_layout import read_associations, read_list, true_poses
from tests.robustness.fuzzing import examples, judged

SIZE = (8, 6)
FRAMES = 1305031102.175304 + np.arange(40) / 30
KINDS = ("uint8", "uint16", "int16", "int32", "uint64", "float16", "float32", "float64", "bool", "complex64", "U3", "O")
SHAPES = ((6, 8), (6, 8), (12, 16), (6, 8, 1), (1, 6, 8), (6, 8, 3), (8, 6), (48,), (), (0, 8), (6, 8, 2))
NUMBERS = ("0", "1", "-1", "1e300", "-1e300", "1e21", "nan", "inf", "1305031102.175304", "0,5", "x", "#", "1e-320", "٣")


@pytest.fixture(autouse=True)
def _quiet():
    logging.getLogger("prgbd").setLevel(logging.ERROR)
    yield
    logging.getLogger("prgbd").setLevel(logging.NOTSET)


def check_depth(path: str, levels_per_metre: float | None = None, invalid: tuple[float, ...] = (0,)) -> None:
    """Read a depth file; what comes out is depth, whatever went in."""
    with judged("depth files"):
        depth = DepthReader("room", SIZE, DepthFormat(levels_per_metre, invalid)).read(Path(path))
        assert depth.shape == SIZE[::-1]
        assert depth.dtype == np.float32
        assert np.isfinite(depth).all()
        assert (depth >= 0).all()


@st.composite
def saved_arrays(draw):
    """Arrays of any type and shape in the bytes that numpy.save writes, some of them damaged."""
    kind = np.dtype(draw(st.sampled_from(KINDS)))
    shape = draw(st.sampled_from(SHAPES))
    array = np.full(shape, {}, object) if kind.hasobject else draw(arrays.arrays(kind, shape))
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return damaged(draw, buffer.getvalue())


def damaged(draw, data: bytes) -> bytes:
    """Leave bytes as they are, cut them off, or change one of the first."""
    how = draw(st.sampled_from(["whole", "whole", "cut", "changed"]))
    if how == "cut":
        return data[: draw(st.integers(0, len(data)))]
    if how == "changed" and data:
        at = draw(st.integers(0, min(len(data), 128) - 1))
        return data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]
    return data


@examples(small=60, large=500)
@given(data=saved_arrays(), levels=st.sampled_from([None, 1.0, 1000.0]), invalid=st.lists(st.floats(-1, 70000)))
def test_arrays_are_depth_or_refused(data, levels, invalid):
    Path("d.npy").write_bytes(data)
    check_depth("d.npy", levels, tuple(invalid))


@examples(small=30, large=300)
@given(
    data=st.data(), kind=st.sampled_from(["uint8", "uint16", "float32", "int32"]), channels=st.sampled_from([1, 3, 4])
)
def test_images_are_depth_or_refused(data, kind, channels):
    suffix = ".tiff" if kind in ("float32", "int32") else ".png"
    shape = data.draw(st.sampled_from([(6, 8), (6, 8), (12, 16), (8, 8)]))
    image = data.draw(arrays.arrays(np.dtype(kind), shape if channels == 1 else (*shape, channels)))
    encoded, buffer = cv2.imencode(suffix, image)
    assert encoded
    Path(f"d{suffix}").write_bytes(damaged(data.draw, buffer.tobytes()))
    check_depth(f"d{suffix}")


@examples(small=30, large=200)
@given(data=st.binary(max_size=300), suffix=st.sampled_from([".npy", ".png", ".exr", ".tiff"]))
def test_any_bytes_are_no_depth(data, suffix):
    Path(f"d{suffix}").write_bytes(data)
    check_depth(f"d{suffix}")


@st.composite
def good_words(draw, columns: int):
    """The words of a line that is right but for the size of its numbers."""
    time = repr(draw(st.sampled_from(FRAMES.tolist()) | st.floats(-1e19, 1e19)))
    far = repr(draw(st.floats(-10, 10) | st.floats(-1e12, 1e12)))
    if columns == 8:
        return [time, far, "2", "3", "0", draw(st.sampled_from(["0", "-0.0", "0.01"])), "0", "1"]
    if columns == 12:
        return ["1", "0", "0", far, "0", "1", "0", "0", "0", "0", "1", "0"]
    return [time, "rgb/1.png", time, "depth/1.png"][:columns]


@st.composite
def pose_lines(draw, columns: int):
    """Lines that are nearly those of a pose file."""
    lines, good = [], draw(st.booleans())
    for _ in range(draw(st.integers(0, 6))):
        width = columns if good else draw(st.sampled_from([columns, columns, columns, 0, 1, columns - 1, columns + 1]))
        words = draw(st.lists(st.sampled_from(NUMBERS) | st.floats().map(repr), min_size=width, max_size=width))
        if good or draw(st.booleans()):
            words = draw(good_words(columns))
        lines.append(draw(st.sampled_from([" ", ",", "\t"])).join(words))
    return draw(st.sampled_from(["\n", "\r\n"])).join(lines)


@examples(small=60, large=500)
@given(text=pose_lines(8))
def test_tum_files_are_read_or_refused(text):
    Path("p.txt").write_text(text, encoding="utf-8")
    with judged("trajectory files"):
        check_poses(read_tum("p.txt").wTc)
    with judged("trajectory files"):
        check_poses(read_tum("p.txt", FRAMES).wTc)
    with judged("true poses"):
        poses = true_poses(Path("p.txt"), FRAMES)
        if poses is not None:
            check_poses(poses[np.isfinite(poses).all(axis=(1, 2))])


@examples(small=30, large=200)
@given(text=pose_lines(12))
def test_kitti_files_are_read_or_refused(text):
    Path("k.txt").write_text(text, encoding="utf-8")
    with judged("trajectory files"):
        check_poses(read_kitti("k.txt").wTc)


def check_poses(wTc: np.ndarray) -> None:
    assert np.isfinite(wTc).all()
    assert np.allclose(np.linalg.det(wTc[:, :3, :3]), 1, atol=0.2)


@examples(small=40, large=300)
@given(text=pose_lines(2) | pose_lines(4))
def test_lists_of_images_are_read_or_refused(text):
    Path("rgb.txt").write_text(text, encoding="utf-8")
    with judged("lists of images"):
        times, files = read_list(Path("rgb.txt"), "rgb")
        assert len(times) == len(files)
        in_seconds(times)
    with judged("lists of images"):
        read_associations(Path("rgb.txt"), "depth")


ascending = st.lists(st.floats(-1e19, 1e19), min_size=1, max_size=30, unique=True).map(sorted).map(np.array)


@examples(small=60, large=500)
@given(times=ascending, frames=ascending)
def test_any_two_clocks_meet_or_are_named(times, frames):
    with judged("clocks"):
        assert np.isfinite(common_clock(times, frames, "the poses").seconds(times)).all()


@examples(small=60, large=500)
@given(
    factor=st.sampled_from([1.0, 1e3, 1e6, 1e9]),
    every=st.integers(1, 6),
    relative=st.booleans(),
    jitter=st.floats(0, 0.003),
)
def test_a_clock_of_another_unit_or_start_is_found(factor, every, relative, jitter):
    moments = FRAMES[::every] + jitter
    times = (moments - FRAMES[0] if relative else moments) * factor
    try:
        clock = common_clock(times, FRAMES, "the poses")
    except DataError as error:
        raise AssertionError(f"{times[:3]}") from error
    np.testing.assert_allclose(clock.seconds(times), moments, atol=1e-3)
    assert bool(clock.note) == (relative or factor != 1)
