"""Bags of both versions that are damaged or cut off: right frames or a sentence, never anything else."""

from __future__ import annotations

import shutil
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from prgbd.core.errors import DataError
from prgbd.plugins.data.rosbag import RosbagSequence
from tests.plugins.data.bags import START, Ros, png
from tests.plugins.data.written import picture
from tests.robustness.fuzzing import examples, judged

KINDS = {"a.bag": (1, "SQLITE3"), "a.db3": (2, "SQLITE3"), "a.mcap": (2, "MCAP")}
STEP = 100_000_000


@cache
def content(name: str, folder: str) -> bytes:
    """The one file of a bag with raw images, compressed ones and depth."""
    version, storage = KINDS[name]
    ros, found = Ros(version), []
    for i in range(4):
        stamp = START + i * STEP
        found.append(("/raw", stamp, ros.image(stamp, picture(i, 16, 12), "rgb8")))
        found.append(("/raw/compressed", stamp, ros.compressed(stamp, png(picture(i, 16, 12)), "png")))
        found.append(("/depth", stamp, ros.image(stamp, np.full((12, 16), 900 + i, np.uint16), "16UC1")))
        found.append(("/camera_info", stamp, ros.info(stamp, (16, 12), (12.0, 0, 8, 0, 12, 6, 0, 0, 1))))
    path = ros.write(Path(folder) / ("whole.bag" if version == 1 else "whole"), found, storage)
    file = path if version == 1 else next(p for p in path.iterdir() if p.suffix == Path(name).suffix)
    data = file.read_bytes()
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    return data


def watched(path: Path, topic: str) -> None:
    """Read a bag in two orders; a frame that can be read has the size of the others."""
    sequence = RosbagSequence(path, image=topic)
    assert np.all(np.diff(sequence.timestamps) > 0)
    for i in [*range(len(sequence)), *range(len(sequence) - 1, -1, -2)]:
        with suppress(DataError):
            frame = sequence.frame(i)
            assert frame.image.shape == (sequence.camera.height, sequence.camera.width, 3)


@examples(small=30, large=300)
@given(name=st.sampled_from(sorted(KINDS)), part=st.floats(0, 1))
def test_a_bag_cut_off_anywhere(name, part):
    data = content(name, str(Path.cwd()))
    path = Path(name)
    path.write_bytes(data[: int(part * len(data))])
    with judged("bags that are cut off"):
        watched(path, "/raw")


@examples(small=60, large=600)
@given(
    name=st.sampled_from(sorted(KINDS)),
    topic=st.sampled_from(["/raw", "/raw/compressed"]),
    places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=12),
)
def test_a_bag_with_flipped_bits(name, topic, places):
    data = bytearray(content(name, str(Path.cwd())))
    for where, bits in places:
        data[int(where * len(data))] ^= bits
    path = Path(name)
    path.write_bytes(data)
    with judged("bags with flipped bits"):
        watched(path, topic)
