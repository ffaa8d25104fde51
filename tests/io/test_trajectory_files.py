"""Trajectory files of other programs."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from prgbd.core.errors import DataError
from prgbd.io.trajectory_files import read_kitti, read_tum

FRAMES = 1305031102.175304 + np.arange(6) / 30
LINES = [f"{i} 0 0 0 0 0 1" for i in range(6)]


def write(times, lines=LINES, encoding="utf-8", newline="\n") -> Path:
    path = Path("theirs.tum")
    path.write_bytes(newline.join(f"{t} {line}" for t, line in zip(times, lines, strict=True)).encode(encoding))
    return path


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_any_encoding_and_line_end_is_read(encoding):
    path = write(FRAMES, encoding=encoding, newline="\r\n")
    np.testing.assert_array_equal(read_tum(path, FRAMES).frame_index, np.arange(6))


@pytest.mark.parametrize("times", [np.round(FRAMES * 1e9).astype(int), FRAMES - FRAMES[0]])
def test_another_clock_is_said(times, caplog):
    with caplog.at_level(logging.WARNING, "prgbd"):
        found = read_tum(write(times), FRAMES)
    np.testing.assert_array_equal(found.frame_index, np.arange(6))
    np.testing.assert_array_equal(found.timestamp, FRAMES)
    assert "theirs.tum" in caplog.text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("timestamp tx ty tz qx qy qz qw\n1 0 0 0 0 0 0 1", "Line 1 .* header"),
        ("1,5 0,1 0,1 0,1 0,0 0,0 0,0 1,0", "decimal points"),
        ("1 0 0 0 0 0 0 3", "length 3 at time 1"),
        ("1 0 0 0 0 0 0 inf", "finite"),
        ("1e300 0 0 0 0 0 0 1", "beyond 1e\\+20"),
        ("1 1e12 0 0 0 0 0 1", "must be in metres"),
        ("\n".join(["1.305031e+09 0 0 0 0 0 0 1"] * 6), "all of their digits"),
    ],
)
def test_a_malformed_trajectory_is_named(text, words):
    Path("theirs.tum").write_text(text)
    with pytest.raises(DataError, match=words):
        read_tum("theirs.tum")


def test_a_matrix_that_is_no_rotation_is_named():
    Path("theirs.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n2 0 0 0 0 2 0 0 0 0 2 0\n")
    with pytest.raises(DataError, match=r"Pose 1 of theirs\.txt is no rigid transform"):
        read_kitti("theirs.txt")
