"""Image files that are cut, changed, or of another kind than their names say; and whatever their names are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from prgbd.io.naming import MOST_BYTES, safe_name
from prgbd.plugins.data._images import SUFFIXES, common_levels, read_image
from prgbd.plugins.data._order import in_order
from prgbd.plugins.data._times import read_times
from tests.robustness.fuzzing import examples, judged

RNG = np.random.default_rng(0)
NOISE = RNG.integers(0, 256, (24, 32, 3), np.uint8)
PICTURES = {
    "colour": NOISE,
    "grey": NOISE[..., 0],
    "transparent": np.dstack([NOISE, NOISE[..., 0]]),
    "16 bits": NOISE[..., 0].astype(np.uint16) * 16,
    "floats": NOISE.astype(np.float32) / 255,
}
NAMES = st.one_of(
    st.from_regex(r"(a|cam1_|IMG_)?[0-9]{1,21}([._-][0-9]{1,10})?", fullmatch=True),
    st.from_regex(r"20[0-9]{6}[_-][0-9]{6}[0-9]{0,6}", fullmatch=True),
    st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=12),
)


def encoded(kind: str, suffix: str) -> bytes:
    """Return a picture as a file of a format, or in colour or grey where the format has no such pictures."""
    for picture in (PICTURES[kind], NOISE, NOISE[..., 0]):
        try:
            done, data = cv2.imencode(suffix, picture)
        except cv2.error:
            continue
        if done:
            return bytes(data)
    raise AssertionError(suffix)


@examples(small=60, large=600)
@given(
    kind=st.sampled_from(sorted(PICTURES)),
    written=st.sampled_from(SUFFIXES),
    named=st.sampled_from(SUFFIXES),
    part=st.one_of(st.just(1.0), st.floats(0, 1)),
    flips=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=3),
    behind=st.binary(max_size=20),
)
def test_images(tmp_path_factory, kind: str, written: str, named: str, part: float, flips: list, behind: bytes) -> None:
    data = bytearray(encoded(kind, written))
    for at, value in flips:
        data[int(at * (len(data) - 1))] = value
    file: Path = tmp_path_factory.getbasetemp() / f"image{named}"
    file.write_bytes(bytes(data[: int(part * len(data))]) + behind)
    with judged("images"):
        levels, _ = common_levels([file])
        image = read_image(file, levels=levels)
        assert image.dtype == np.uint8
        assert image.ndim == 3


@examples(small=80, large=600)
@given(names=st.lists(NAMES, min_size=1, max_size=12, unique=True), fps=st.one_of(st.none(), st.floats(0.1, 100)))
def test_names(names: list[str], fps: float | None) -> None:
    with judged("names of images"):
        order = in_order([Path("in") / f"{name}.png" for name in names])
        assert sorted(path.name for path in order.images) == sorted(f"{name}.png" for name in names)
        assert np.all(np.diff(order.timestamps(fps, 30.0)) > 0)


@examples(small=60, large=400)
@given(
    rows=st.lists(st.one_of(st.floats().map(str), st.integers(0, 10**19).map(str), st.text(max_size=20)), max_size=4),
    names=st.booleans(),
)
def test_files_of_times(tmp_path_factory, rows: list[str], names: bool) -> None:
    file: Path = tmp_path_factory.getbasetemp() / "times.txt"
    file.write_text("\n".join(f"{row} a.png" if names else row for row in rows), encoding="utf-8")
    with judged("files of times"):
        _, times = read_times(file, [Path("in/a.png"), Path("in/b.png")])
        assert np.all(np.diff(times) > 0)


@examples(small=60, large=400)
@given(first=st.text(max_size=60), second=st.text(max_size=60))
def test_names_of_recordings(first: str, second: str) -> None:
    assert (safe_name(first) == safe_name(second)) == (first == second)
    assert len(safe_name(first).encode()) <= MOST_BYTES + 10
    assert "/" not in safe_name(first)
