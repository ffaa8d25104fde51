"""Video files that are damaged, cut off, or none: right pictures or a sentence, never anything else."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from prgbd.core.errors import DataError
from prgbd.plugins.data.video import VideoSequence
from tests.plugins.data.filmed import coded, film, number_of
from tests.robustness.fuzzing import examples, judged

FRAMES = 24
FRAGMENTED = {"movflags": "frag_keyframe+empty_moov"}
KINDS = {
    "a.mp4": ("libx264", {"g": 8, "bf": 2}),
    "fragmented.mp4": ("libx264", {"g": 8, "bf": 2, "container": FRAGMENTED}),
    "a.mkv": ("libx264", {"g": 8}),
    "a.webm": ("libvpx-vp9", {"g": 8, "cpu-used": 8}),
    "a.avi": ("mjpeg", {"pixels": "yuvj420p", "base": Fraction(1, 30)}),
    "a.ts": ("mpeg2video", {"g": 8, "bf": 2, "base": Fraction(1, 30)}),
    "a.gif": ("gif", {"pixels": "rgb8"}),
}


@cache
def content(name: str, folder: str) -> bytes:
    codec, options = KINDS[name]
    path = Path(folder) / name
    film(path, (coded(i, 64, 32) for i in range(FRAMES)), codec, **options)
    data = path.read_bytes()
    path.unlink()
    return data


def watched(path: Path) -> list[tuple[int, int]]:
    """Read a video in two orders; return the number by its time and the number shown, where a frame can be read."""
    sequence = VideoSequence(path, fov=60, repeats="keep")
    assert np.all(np.diff(sequence.timestamps) > 0)
    numbers = []
    for i in [*range(len(sequence)), *range(len(sequence) - 1, -1, -5)]:
        with suppress(DataError):
            image = sequence.frame(i).image
            assert image.shape == (sequence.camera.height, sequence.camera.width, 3)
            numbers.append((round(float(30 * sequence.timestamps[i])), number_of(image)))
    return numbers


@examples(small=35, large=300)
@given(name=st.sampled_from(sorted(KINDS)), part=st.floats(0, 1))
def test_a_video_cut_off_anywhere(name, part):
    data = content(name, str(Path.cwd()))
    path = Path(f"cut-{name}")
    path.write_bytes(data[: int(part * len(data))])
    with judged("videos that are cut off"):
        numbers = watched(path)
        # A GIF's decoder does not tell that the last picture lacks its end.
        assert name == "a.gif" or all(timed == shown for timed, shown in numbers)


@examples(small=35, large=400)
@given(
    name=st.sampled_from(sorted(KINDS)),
    places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=12),
)
def test_a_video_with_flipped_bits(name, places):
    data = bytearray(content(name, str(Path.cwd())))
    for where, bits in places:
        data[int(where * len(data))] ^= bits
    path = Path(f"flipped-{name}")
    path.write_bytes(data)
    with judged("videos with flipped bits"):
        watched(path)


@examples(small=15, large=100)
@given(suffix=st.sampled_from([".mp4", ".mkv", ".avi", ".ts", ".h264", ".gif"]), data=st.binary(max_size=400))
def test_a_file_that_is_no_video(suffix, data):
    path = Path(f"noise{suffix}")
    path.write_bytes(data)
    with judged("files that are no videos"):
        watched(path)
