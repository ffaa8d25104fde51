"""When the frames of an MP4 or MOV file are shown, read from its tables without decoding anything.

ISO/IEC 14496-12: a track's ``stts`` lists how long each sample lasts, ``ctts`` how much later than decoded it is shown.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

LARGEST_INDEX = 1 << 28  # bytes of a ``moov`` box that are read
MOST_FRAMES = 1 << 26


def frame_times(path: Path) -> NDArray[np.float64] | None:
    """Return the time of every frame of the first video track, (N,) seconds ascending from 0.

    Returns:
        None for other containers, fragmented files, and tables that make no sense: the frame rate must do then.
    """
    try:
        with path.open("rb") as file:
            moov = _read_moov(file, path.stat().st_size)
        return None if moov is None else _times(moov)
    except (OSError, struct.error, ValueError, StopIteration):
        return None


def _read_moov(file: BinaryIO, size: int) -> bytes | None:
    at = 0
    while at + 8 <= size:
        file.seek(at)
        header = file.read(16)
        length, kind, skip = _header(header, size - at)
        if kind == b"moov":
            file.seek(at + skip)
            return bytes(file.read(min(length - skip, LARGEST_INDEX)))
        at += length
    return None


def _header(data: bytes, rest: int) -> tuple[int, bytes, int]:
    """Length of a box, its kind, and the length of its header."""
    length, kind = struct.unpack(">I4s", data[:8])
    skip = 8
    if length == 1:
        (length,) = struct.unpack(">Q", data[8:16])
        skip = 16
    length = rest if length == 0 else length
    if length < skip:
        raise ValueError("a box is shorter than its header")
    return length, kind, skip


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(data):
        length, kind, skip = _header(data[at : at + 16], len(data) - at)
        yield kind, data[at + skip : at + length]
        at += length


def _inside(data: bytes, *kinds: bytes) -> bytes:
    """The first box within boxes; StopIteration without."""
    for kind in kinds:
        data = next(content for found, content in _boxes(data) if found == kind)
    return data


def _times(moov: bytes) -> NDArray[np.float64] | None:
    for kind, track in _boxes(moov):
        if kind != b"trak" or _inside(track, b"mdia", b"hdlr")[8:12] != b"vide":
            continue
        header = _inside(track, b"mdia", b"mdhd")
        (scale,) = struct.unpack_from(">I", header, 20 if header[0] == 1 else 12)
        table = _inside(track, b"mdia", b"minf", b"stbl")
        (runs,) = struct.unpack_from(">I", stts := _inside(table, b"stts"), 4)
        lasts = np.frombuffer(stts, ">u4", 2 * runs, 8).reshape(-1, 2).astype(np.int64)
        if scale == 0 or not 0 < lasts[:, 0].sum() < MOST_FRAMES:
            return None
        shown = np.concatenate([[0], np.cumsum(np.repeat(lasts[:, 1], lasts[:, 0]))[:-1]])
        shown = np.sort(shown + _delays(table, len(shown)))
        times = (shown - shown[0]) / scale
        return times if np.all(np.diff(times) > 0) else None
    return None


def _delays(table: bytes, frames: int) -> NDArray[np.int64]:
    content = next((content for kind, content in _boxes(table) if kind == b"ctts"), None)
    if content is None:
        return np.zeros(frames, np.int64)
    (runs,) = struct.unpack_from(">I", content, 4)
    kind = ">i4" if content[0] == 1 else ">u4"
    counts = np.frombuffer(content, ">u4", 2 * runs, 8)[0::2].astype(np.int64)
    delays = np.repeat(np.frombuffer(content, kind, 2 * runs, 8)[1::2].astype(np.int64), counts)
    if len(delays) != frames:
        raise ValueError("the tables are of different length")
    return delays
