"""Streams that are damaged: pictures that can be read again, or a sentence; it never hangs."""

from __future__ import annotations

import shutil
from fractions import Fraction
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from prgbd.plugins.data import _live_source
from prgbd.plugins.data.camera import CameraSequence
from tests.plugins.data.filmed import coded, film
from tests.robustness.fuzzing import examples, judged

KINDS = {
    "a.mkv": ("libx264", {"g": 3}),
    "a.avi": ("mjpeg", {"pixels": "yuvj420p", "base": Fraction(1, 30)}),
    "a.ts": ("mpeg2video", {"g": 3, "base": Fraction(1, 30)}),
}


@cache
def content(name: str, folder: str) -> bytes:
    codec, options = KINDS[name]
    path = film(Path(folder) / name, (coded(i, 64, 32) for i in range(6)), codec, **options)
    data = path.read_bytes()
    path.unlink()
    return data


@examples(small=25, large=200)
@given(
    name=st.sampled_from(sorted(KINDS)),
    part=st.one_of(st.just(1.0), st.floats(0.5, 1)),
    places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), max_size=5),
)
def test_a_damaged_stream(name, part, places):
    data = bytearray(content(name, str(Path.cwd())))
    for where, bits in places:
        data[int(where * len(data))] ^= bits
    path, folder = Path(name), Path("camera")
    path.write_bytes(data[: int(part * len(data))])
    shutil.rmtree(folder, ignore_errors=True)
    with judged("streams that are damaged"), mock.patch.object(_live_source, "GAP", 0.3):
        sequence = CameraSequence(path, folder, fov=60)
        assert np.all(np.diff(sequence.timestamps) > 0)
        assert all(frame.image.shape == (32, 64, 3) for frame in sequence)
