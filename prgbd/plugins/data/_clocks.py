"""Times that are written into names: Unix clocks in every unit and spelling, dates with a time of day, seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from itertools import pairwise

EPOCH = (1_000_000_000, 2_500_000_000)  # Unix seconds from 2001 to 2049: what looks like a clock
UNITS = {1: "seconds", 10**3: "milliseconds", 10**6: "microseconds", 10**9: "nanoseconds"}  # parts of a second
FEWEST_DECIMALS = 3  # of seconds since some start; fewer may be the number of a part, as in 2.10
PARTS = (6, 9)  # digits of micro- and nanoseconds, which some programs write without leading zeros
FASTEST = Fraction(1, 500)  # seconds between images; what is faster is no time

_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_SPLIT = re.compile(r"(?<![\d.])(1\d{9}|2[0-4]\d{8})([._-])(\d{1,9})(?![\d.])")
_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)([-_.:]?)([01]\d)\2([0-3]\d)[-_.T ]{0,3}([012]\d)([-_.:h]?)([0-5]\d)[-_.:m]?([0-5]\d)"
    r"(?:[-_.,]?(\d{3}|\d{6}|\d{9}))?(?!\d)",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Clock:
    """What names say of times.

    Attributes:
        times: Seconds of each name, None where it tells none.
        words: What kind of clock it is.
        rest: The names without the time.
    """

    times: list[Fraction | None]
    words: str
    rest: list[str]

    @property
    def coarse(self) -> bool:
        """Whether it shows whole seconds alone."""
        return all(time is None or time.denominator == 1 for time in self.times)


def read_clock(names: Sequence[str]) -> Clock | None:
    """Return the clock by which at least half of the names, and two, were written, or None.

    Args:
        names: Of files, without their endings.
    """
    for read in (_dates, _split_seconds, _unix, _seconds):
        clock = read(names)
        known = sorted({time for time in clock.times if time is not None})
        if 2 * sum(time is not None for time in clock.times) < len(names) or len(known) < 2:
            continue
        steps = sorted(b - a for a, b in pairwise(known))
        if steps[len(steps) // 2] >= FASTEST:
            return clock
    return None


def _dates(names: Sequence[str]) -> Clock:
    """Read dates with a time of day; they are taken as UTC, since differences alone matter."""
    times = [_date(_DATE.search(name)) for name in names]
    known = [time for time in times if time is not None]
    # A date and a frame number of six digits, as in 20240101_000001, reads like a time that begins at midnight.
    if known and min(known) % 86400 <= 1:
        times = [None] * len(names)
    return Clock(times, "dates", [_DATE.sub("", name) for name in names])


def _date(found: re.Match[str] | None) -> Fraction | None:
    if found is None:
        return None
    year, _, month, day, hour, _, minute, second, part = found.groups()
    try:
        moment = datetime(*map(int, (year, month, day, hour, minute, second)), tzinfo=UTC)  # type: ignore[misc,arg-type]
    except ValueError:  # the 31st of February
        return None
    return int(moment.timestamp()) + (Fraction(int(part), 10 ** len(part)) if part else Fraction(0))


def _split_seconds(names: Sequence[str]) -> Clock:
    """Read Unix seconds whose fraction is a number of its own: ``SECONDS_NANOSECONDS``, or decimals.

    Programs that join the two without leading zeros write .5 s of nanoseconds as 500000000 but .05 s as 50000000.
    Whether digits are decimals or such a number is told by which of the two gives the more even steps.
    """
    found = [_SPLIT.search(name) for name in names]
    parts = [match for match in found if match is not None]
    lengths = {len(match[3]) for match in parts}
    rest = [_SPLIT.sub("", name) for name in names]
    clock = Clock([None] * len(names), "", rest)
    if not parts:
        return clock
    decimals = [None if match is None else Fraction(f"{match[1]}.{match[3]}") for match in found]
    if all(match[2] == "." for match in parts) or (len(lengths) == 1 and lengths <= {3, *PARTS}):
        clock = Clock(decimals, "Unix seconds", rest)
    digits = max(lengths)
    if len(lengths) > 1 and digits in PARTS:
        joined = [None if match is None else int(match[1]) + Fraction(int(match[3]), 10**digits) for match in found]
        if not any(clock.times) or _unevenness(joined) < _unevenness(decimals):
            clock = Clock(joined, f"Unix seconds and {UNITS[10**digits]}", rest)
    return clock


def _unevenness(times: Sequence[Fraction | None]) -> Fraction:
    """The mean absolute deviation of the steps from their median."""
    known = sorted(time for time in times if time is not None)
    steps = sorted(b - a for a, b in pairwise(known))
    middle = steps[len(steps) // 2] if steps else Fraction(0)
    return sum((abs(step - middle) for step in steps), Fraction(0))


def _unix(names: Sequence[str]) -> Clock:
    """Read Unix times as one number, whatever their unit."""
    times: list[Fraction | None] = []
    rest = []
    unit = 1
    for name in names:
        number, unit = next(((n, u) for n in _NUMBER.findall(name) if (u := _unit(Fraction(n)))), ("", unit))
        times.append(Fraction(number) / unit if number else None)
        rest.append(name.replace(number, "") if number else name)
    return Clock(times, f"Unix {UNITS[unit]}", rest)


def _unit(value: Fraction) -> int | None:
    """Return how many of its units a second has, if it is the time of a clock."""
    return next((unit for unit in UNITS if EPOCH[0] * unit <= value < EPOCH[1] * unit), None)


def _seconds(names: Sequence[str]) -> Clock:
    """Read seconds since some start, if every name has one number with decimals, and enough of them."""
    found = [[number for number in _NUMBER.findall(name) if "." in number] for name in names]
    decimals = [len(numbers[0].split(".")[1]) for numbers in found if numbers]
    if not decimals or max(decimals) < FEWEST_DECIMALS or any(len(numbers) != 1 for numbers in found):
        return Clock([None] * len(names), "", list(names))
    times: list[Fraction | None] = [Fraction(numbers[0]) for numbers in found]
    rest = [name.replace(numbers[0], "") for name, numbers in zip(names, found, strict=True)]
    return Clock(times, "seconds", rest)
