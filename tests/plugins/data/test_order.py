"""Order and times by the names of images, and by a file."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from prgbd.core.errors import DataError
from prgbd.plugins.data._order import in_order
from prgbd.plugins.data._times import read_times

TIMES = 1678886400.2 + np.cumsum(1 / 30 + np.random.default_rng(1).normal(0, 0.001, 40))
NANOSECONDS = [round(time * 1e9) for time in TIMES]
NOON = datetime(2024, 1, 31, 23, 59, 59)
CLOCKS = {
    "as Python writes them": [repr(float(time)) for time in TIMES],
    "nanoseconds": [f"{time}" for time in NANOSECONDS],
    "microseconds": [f"cam0-{time // 1000}" for time in NANOSECONDS],
    "milliseconds": [f"frame{time // 10**6}x" for time in NANOSECONDS],
    "without leading zeros": [f"{time // 10**9}.{time % 10**9}" for time in NANOSECONDS],
    "in two numbers": [f"{time // 10**9}_{time % 10**9:09d}" for time in NANOSECONDS],
    "with a counter": [f"{1000 + i}_{float(time)!r}" for i, time in enumerate(TIMES)],
}
DATES = ["IMG_%Y%m%d_%H%M%S%f", "%Y-%m-%dT%H-%M-%S.%f", "%Y-%m-%d %H.%M.%S,%f", "PXL_%Y%m%d-%Hh%Mm%S_%f.MP"]
COUNTERS = {
    "padded": [f"frame_{i:06d}" for i in range(100, 140)],
    "not padded": [f"img{i}" for i in range(1, 41)],
    "ten digits": [f"{i:010d}" for i in range(40)],
    "a day and a counter": [f"20240101_{i:06d}" for i in range(40)],
    "nanoseconds since the start": [str(52345678901234 + i * 33333333) for i in range(40)],
}


def shuffled(names: list[str]) -> list[Path]:
    return [Path("in") / f"{names[i]}.png" for i in np.random.default_rng(0).permutation(len(names))]


@pytest.mark.parametrize("kind", CLOCKS)
def test_a_clock_gives_order_and_times(kind: str, caplog) -> None:
    order = in_order(shuffled(CLOCKS[kind]))
    assert [path.name[:-4] for path in order.images] == CLOCKS[kind]
    np.testing.assert_allclose(order.times, TIMES, rtol=0, atol=2e-3 if kind == "milliseconds" else 2e-6)
    assert order.words.startswith("times from names (Unix ")
    assert not caplog.messages


@pytest.mark.parametrize("kind", DATES)
def test_dates_give_times(kind: str) -> None:
    names = [(NOON + timedelta(seconds=i / 10)).strftime(kind) for i in range(40)]
    order = in_order(shuffled(names))
    assert [path.name[:-4] for path in order.images] == names
    np.testing.assert_allclose(np.diff(order.times), 0.1, atol=1e-6)


@pytest.mark.parametrize("kind", COUNTERS)
def test_counters_give_order(kind: str, caplog) -> None:
    order = in_order(shuffled(COUNTERS[kind]))
    assert [path.stem for path in order.images] == COUNTERS[kind]
    assert order.times is None
    np.testing.assert_allclose(order.counts, range(40))
    assert not caplog.messages


def test_seconds_since_the_start_are_times_and_parts_are_not() -> None:
    np.testing.assert_allclose(in_order(shuffled([str(i / 30) for i in range(40)])).times, np.arange(40) / 30)
    assert [path.stem for path in in_order(shuffled(["1.1", "1.2", "1.9", "1.10"])).images][-1] == "1.10"


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([f"IMG_20240101_1200{i // 3:02d}_{i % 3}" for i in range(12)], "tell whole seconds alone"),
        (["1.1", "1.2", "1.9", "1.10"], "decimals or numbers with parts"),
        ([f"{side}_{i}" for side in ("left", "right") for i in range(4)], r"2 kinds (left_#, right_#)"),
        ([f"seq{part}_{i}" for part in (1, 2) for i in range(4)], "start to count again at seq2_0"),
        ([f"{i:02d}_{20 - i}" for i in range(9)], "contradict their order"),
        (["one", "two", "three"], "no number that orders them"),
        (["3", "90", "91", "500", "507", "9000"], "uneven steps"),
        ([*DATES, "cover"], "no number that orders them"),
    ],
)
def test_what_names_leave_open_is_said(names: list[str], words: str, caplog) -> None:
    in_order(shuffled(names))
    assert words in caplog.text


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([*CLOCKS["as Python writes them"], "cover"], r"named by their times .*, but cover\.png is not"),
        ([f"cam{i % 2}_{NANOSECONDS[i // 2]}" for i in range(20)], "have the same time in their names"),
    ],
)
def test_times_that_cannot_be_are_refused(names: list[str], words: str) -> None:
    with pytest.raises(DataError, match=words):
        in_order(shuffled(names))


def test_one_name_with_two_endings_is_refused() -> None:
    with pytest.raises(DataError, match=r"holds 1\.jpg and 1\.png, two images of one name"):
        in_order([Path("in/1.png"), Path("in/2.png"), Path("in/1.jpg")])


IMAGES = [Path(f"in/{name}.png") for name in "abc"]


@pytest.mark.parametrize(
    ("text", "names", "times"),
    [
        ("0.5\n0.6\n0.8\n", "abc", [0.5, 0.6, 0.8]),
        ("# a list\n1305031452.79 rgb/c.png\n1305031452.82 rgb/a.png\n", "ca", [1305031452.79, 1305031452.82]),
        ("time;name\n1403636579763555584;b\n1403636579813555456;a\n", "ba", [1403636579.763555584, 1403636579.8135555]),
        (
            "2011-09-26 13:02:25.964\n2011-09-26 13:02:26.068\n2011-09-26T13:02:26.2\n",
            "abc",
            [1317042145.964, 1317042146.068, 1317042146.2],
        ),
    ],
)
def test_files_of_times(tmp_path: Path, text: str, names: str, times: list[float]) -> None:
    file = tmp_path / "times.txt"
    file.write_text(text)
    images, seconds = read_times(file, IMAGES)
    assert "".join(path.stem for path in images) == names
    np.testing.assert_allclose(seconds, times, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1\n2\n", "has 2 times, but there are 3 images"),
        ("", "has 0 times"),
        ("1\n2\n2\n", "Line 3 .* has the same time as the line before"),
        ("# a\n1\n\n3\n2\n", "Line 5 .* has an earlier time"),
        ("1 a\n2 d.png\n", r"has 'd\.png', which does not lie in in"),
        ("1 a\n2\n", "has no name in a line"),
        ("1\nsoon\n3\n", "Line 2 .* does not begin with a time"),
        ("nan\n1\n2\n3\nx", "Line 5"),
        ("1\n1e999999999\n3\n", "Line 2 .* does not begin"),
    ],
)
def test_wrong_files_of_times(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "times.txt"
    file.write_text(text)
    with pytest.raises(DataError, match=words):
        read_times(file, IMAGES)
