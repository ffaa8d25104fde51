"""The clock of a file beside the clock of the recording: units and starts that differ are recognised, and said.

Poses, depth images and colour images find each other by their times. Where a file counts in nanoseconds, or in seconds
from the start, no time would meet another, and the file would count as absent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError

Times = NDArray[np.float64]

REACH = 0.02  # seconds that two times of one moment may differ by, as in the TUM data set's own tools
UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
SINCE_1970 = 1e8  # seconds; times beyond count from 1970, times below from a start of their own

_AT_ONCE = 0.25  # of the images have a time of the file within REACH: the clocks are one, whatever else may fit
_BETTER = 10.0  # times as good must another unit fit
_FEWEST = 3  # images that must find a time for a guess to count
_SHORTEST_STEP = 0.002  # seconds: nothing gives poses at more than 500 Hz
_LARGEST_REACH = 0.5  # seconds, where times are far apart
_EXACT = 0.1  # of the time between two images
_HOUR = 3600.0


@dataclass(frozen=True)
class Clock:
    """How the times of a file become those of the recording.

    Attributes:
        factor: Seconds per unit of the file.
        offset: Seconds to add.
        note: A sentence about what was assumed; "" where the clocks are one.
    """

    factor: float = 1.0
    offset: float = 0.0
    note: str = ""

    def seconds(self, times: Times) -> Times:
        """Return times of the file on the recording's clock."""
        return np.asarray(times, np.float64) * self.factor + self.offset if self.note else times


def common_clock(times: Times, frames: Times, what: str) -> Clock:
    """Find out how the times of a file and the times of a recording's images belong together.

    Another unit is certain where it makes times meet that did not. Times that begin at 0, beside images whose times do
    not, are taken to count from the first image. Both are said in the clock's note.

    Args:
        times: (N,) times of the file, ascending.
        frames: (F,) seconds of the images, ascending.
        what: What the file is, such as ``"the true poses of groundtruth.txt"``.

    Raises:
        DataError: If the times do not meet and nothing explains it; the sentence gives both ranges.
    """
    if len(times) == 0 or len(frames) == 0 or _found(times, frames, REACH) >= max(1.0, _AT_ONCE * len(frames)):
        return Clock()
    same = _fit(times, frames)
    best = max(UNITS, key=lambda unit: _fit(times * UNITS[unit], frames))
    factor = UNITS[best]
    if _step(times) * factor >= _SHORTEST_STEP and _fit(times * factor, frames) > _BETTER * same:
        note = f"The times of {what} ({_range(times)}) look like {best} beside those of the images ({_range(frames)})"
        return Clock(factor, 0.0, f"{note}, and are taken as such.")
    if same > 0 or _overlap(times, frames):
        return Clock()
    return _from_start(times, frames, what)


def in_seconds(times: Times) -> Clock:
    """Return the clock of a recording's own times, whose unit shows where they count from 1970."""
    last = float(np.abs(times).max(initial=0.0))
    units = [unit for unit, factor in UNITS.items() if last * factor > SINCE_1970]
    if not units:
        return Clock()
    return Clock(UNITS[units[-1]], 0.0, f"The times ({_range(times)}) look like {units[-1]}, and are taken as such.")


def no_meeting(times: Times, frames: Times, what: str) -> str:
    """Return a sentence about times that do not meet, with both ranges."""
    gap = float(times[0] - frames[0])
    hours = round(gap / _HOUR)
    mend = "give both in seconds of one clock"
    if hours and abs(gap - hours * _HOUR) < min(60.0, _HOUR * abs(hours) / 10):
        mend = f"they are {abs(hours)} h apart, as clocks of two time zones are: shift one of them"
    return f"The times of {what} ({_range(times)}) and of the images ({_range(frames)}) do not meet; {mend}."


def _from_start(times: Times, frames: Times, what: str) -> Clock:
    """Return the clock of times that count from the start of the recording, in any unit, or since 1970 where it does.

    Raises:
        DataError: If they do not.
    """
    best, best_fit = None, 0.0
    for unit, factor in {"seconds": 1.0, **UNITS}.items():
        seconds = times * factor
        if len(seconds) > 1 and _step(seconds) < _SHORTEST_STEP:
            continue
        if frames[0] > frames[-1] - frames[0] >= 0 and 0 <= seconds[0] <= max(frames[-1] - frames[0], 1.0):
            offset, words = frames[0], f"look like {unit} from the start, and are counted from the first image"
        elif 0 <= frames[0] <= 1.0 and seconds[0] > SINCE_1970 and _coincide(seconds, frames):
            offset = frames[0] - seconds[0]
            words = f"look like {unit} since 1970, and the first is taken as the first image's"
        else:
            continue
        fit = _fit(seconds + offset, frames)
        if fit > best_fit:
            ranges = f"The times of {what} are {_range(times)}, those of the images {_range(frames)}"
            best, best_fit = Clock(factor, float(offset), f"{ranges}: the former {words}."), fit
    if best is None:
        raise DataError(no_meeting(times, frames, what))
    return best


def _coincide(seconds: Times, frames: Times) -> bool:
    """Say whether times whose first is put on the first image's lie exactly on those of images."""
    shifted = seconds - seconds[0] + frames[0]
    return _found(shifted, frames, _EXACT * _step(frames)) >= 0.5 * min(len(frames), len(seconds))


def _fit(times: Times, frames: Times) -> float:
    """Return how well times meet: the share of images that find a time times the share of times among the images."""
    found = _found(times, frames, _reach(times, frames))
    if found < min(_FEWEST, len(frames)):
        return 0.0
    inside = np.count_nonzero((times >= frames[0] - REACH) & (times <= frames[-1] + REACH))
    return float(found / len(frames) * inside / len(times))


def _found(times: Times, frames: Times, reach: float) -> int:
    """Return how many images have a time within reach."""
    after = np.clip(np.searchsorted(times, frames), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(np.abs(times[after] - frames), np.abs(times[before] - frames))
    return int(np.count_nonzero(nearest <= reach))


def _overlap(times: Times, frames: Times) -> bool:
    return bool(times[0] <= frames[-1] + REACH and times[-1] >= frames[0] - REACH)


def _reach(times: Times, frames: Times) -> float:
    return float(np.clip(0.5 * max(_step(times), _step(frames)), REACH, _LARGEST_REACH))


def _step(times: Times) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def _range(times: Times) -> str:
    return f"{_written(float(times[0]))} to {_written(float(times[-1]))}"


def _written(time: float) -> str:
    return f"{time:.0f}" if abs(time) > 1e15 else f"{time:.3f}".rstrip("0").rstrip(".")
