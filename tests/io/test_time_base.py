"""Times of files on other clocks than the images'."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.core.errors import DataError
from prgbd.io.time_base import common_clock, in_seconds

START = 1305031102.175304
FRAMES = START + np.arange(40) / 30
SHORT = np.arange(1000) / 10  # as KITTI's, from 0


@pytest.mark.parametrize(
    ("times", "frames"),
    [
        (FRAMES, FRAMES),
        (FRAMES[::6], FRAMES),  # poses at 5 Hz
        (FRAMES[::6] + 0.05, FRAMES[::3]),  # none within 0.02 s, but all between two
        (START - 5 + np.arange(3000) / 100, FRAMES),  # a motion capture
        (np.arange(54000) / 30, np.arange(20) / 30),  # the first images of a long trajectory
        (np.arange(1800.0), np.arange(20) / 30),  # of its keyframes
        (SHORT[:20], SHORT),
        (FRAMES[:1], FRAMES),
    ],
)
def test_times_that_meet_are_left_alone(times, frames):
    clock = common_clock(times, frames, "the poses")
    assert clock.note == ""
    assert clock.seconds(times) is times


@pytest.mark.parametrize(
    ("times", "frames", "words"),
    [
        (FRAMES * 1e9, FRAMES, "look like nanoseconds"),
        (FRAMES[::6] * 1e9, FRAMES, "look like nanoseconds"),
        (FRAMES * 1e6, FRAMES, "look like microseconds"),
        (FRAMES * 1e3, FRAMES, "look like milliseconds"),
        (SHORT * 1e3, SHORT, "look like milliseconds"),
        (FRAMES - START, FRAMES, "look like seconds from the start"),
        ((FRAMES - START) * 1e3, FRAMES, "look like milliseconds from the start"),
        ((FRAMES - START) * 1e9, FRAMES, "look like nanoseconds from the start"),
        (SHORT + START, SHORT, "look like seconds since 1970"),
        ((SHORT + START) * 1e9, SHORT, "look like nanoseconds since 1970"),
    ],
)
def test_another_clock_is_converted_and_said(times, frames, words):
    clock = common_clock(times, frames, "the poses of p.txt")
    assert words in clock.note
    assert "the poses of p.txt" in clock.note
    stride = len(frames) // len(times) + 1 if len(times) < len(frames) else 1
    np.testing.assert_allclose(clock.seconds(times), frames[::stride][: len(times)], atol=1e-6)


@pytest.mark.parametrize(("shift", "words"), [(7200, "2 h apart"), (3, "one clock"), (5000 - START, "one clock")])
def test_times_that_nothing_brings_together_are_named_with_both_ranges(shift, words):
    with pytest.raises(DataError, match=words) as caught:
        common_clock(FRAMES + shift, FRAMES, "the poses")
    assert "1305031102.175 to 1305031103.475" in str(caught.value)


def test_the_unit_of_a_recordings_own_times_shows_since_1970():
    for factor, words in ((1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")):
        clock = in_seconds(FRAMES * factor)
        assert words in clock.note
        np.testing.assert_allclose(clock.seconds(FRAMES * factor), FRAMES, atol=1e-6)
    assert in_seconds(FRAMES).note == in_seconds(SHORT).note == ""
