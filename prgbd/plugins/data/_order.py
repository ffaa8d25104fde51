"""The order and the times of a folder of images, by what their names say."""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.plugins.data._clocks import Clock, read_clock

log = logging.getLogger("prgbd")

AGREES = 0.1  # relative difference of a frame rate that a user knows in round figures from the names' own
UNEVEN = 0.5  # of the steps between the numbers differ by as much from the median: they count no frames
MENDS = "give the order and times in a file (data.times)"


@dataclass(frozen=True)
class Order:
    """The images of a folder in order.

    Attributes:
        images: The files.
        counts: (N,) how many frames after the first each image is; a gap in the numbers is a gap.
        times: (N,) seconds, where the names are those of a clock, else None.
        words: What was understood.
    """

    images: list[Path]
    counts: NDArray[np.float64]
    times: NDArray[np.float64] | None
    words: str

    def timestamps(self, fps: float | None, default: float) -> NDArray[np.float64]:
        """Return (N,) seconds.

        Args:
            fps: Frames per second that the user gave; None takes the names' times.
            default: Frames per second where nobody says anything.
        """
        if self.times is None or len(self.times) < 2:
            return self.counts / (default if fps is None else fps)
        rate = 1 / float(np.median(np.diff(self.times)))
        if fps is None or abs(fps / rate - 1) < AGREES:
            return self.times
        log.warning(
            "The names of the images in %s are times at %.3g Hz, but data.fps=%g is given and taken; leave it out to "
            "take the names' times.",
            self.images[0].parent,
            rate,
            fps,
        )
        return (self.times - self.times[0]) * rate / fps


def in_order(images: Sequence[Path]) -> Order:
    """Put images in the order that their names say, and tell their times where the names do.

    Names with a clock (Unix seconds, milli-, micro- or nanoseconds; a date with a time of day) give order and times.
    Otherwise numbers are compared as numbers and words as words, and a number that ascends counts the frames. What
    is ambiguous is said in a warning.

    Args:
        images: The files, at least one, of one folder.

    Raises:
        DataError: If two images have one name but for the ending, or one time, or some no time where the others do.
    """
    ordered = sorted(images, key=lambda path: natural_key(path.name))
    stem, times = Counter(path.stem for path in ordered).most_common(1)[0]
    if times > 1:
        twins = " and ".join(path.name for path in ordered if path.stem == stem)
        raise DataError(f"{ordered[0].parent} holds {twins}, two images of one name; give each kind its own folder.")
    clock = read_clock([path.stem for path in ordered])
    by_clock = None if clock is None else _by_clock(ordered, clock)
    return by_clock or _by_numbers(ordered, quiet=clock is not None)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares runs of digits by their number."""
    parts = re.split(r"([0-9]+)", name)
    return [(0, int(p), p) if i % 2 else (1, 0, p) for i, p in enumerate(parts)]


def _by_clock(images: list[Path], clock: Clock) -> Order | None:
    """Return the order by a clock, or None where it does not tell the images apart but their other numbers do."""
    times = [time for time in clock.times if time is not None]
    folder = images[0].parent
    if len(times) < len(images):
        stray = images[clock.times.index(None)].name
        if times != sorted(times):  # so the natural order would mix them up
            raise DataError(
                f"Most images in {folder} are named by their times ({clock.words}), but {stray} is not; move it out "
                f"or {MENDS}."
            )
        log.warning("Most images in %s are named by their times, but %s is not; is it a part of it?", folder, stray)
        return None
    order = sorted(range(len(images)), key=lambda index: times[index])
    twice = next((pair for pair in pairwise(order) if times[pair[0]] == times[pair[1]]), None)
    if twice is not None and not clock.coarse:
        first, second = (images[index].name for index in twice)
        raise DataError(
            f"{first} and {second} in {folder} have the same time in their names ({clock.words}); leave one out, and "
            "give every camera a folder of its own."
        )
    if twice is not None:
        log.warning(
            "The names of the images in %s tell whole seconds alone, so their order is that of the further numbers, "
            "and they count as equally far apart; %s.",
            folder,
            MENDS,
        )
        return None
    _warn_of_another_order(folder, [clock.rest[index] for index in order])
    seconds = np.array([float(times[index]) for index in order])
    said = f"times from names ({clock.words})"
    return Order([images[index] for index in order], np.arange(len(images), dtype=np.float64), seconds, said)


def _by_numbers(images: list[Path], quiet: bool) -> Order:
    """Return the natural order, and the gaps in it by the number that counts the frames, if there is one."""
    names = [path.stem for path in images]
    folder = images[0].parent
    if not quiet:
        _warn_of_doubts(folder, names)
    even = np.arange(len(images), dtype=np.float64)
    column = next((column for column in reversed(_columns(names)) if all(a < b for a, b in pairwise(column))), None)
    if column is None or len(column) < 2:
        return Order(images, even, None, "")
    steps = np.array([float(b - a) for a, b in pairwise(column)])
    middle = float(np.median(steps))
    if len(steps) > 3 and np.mean(np.abs(steps / middle - 1) > UNEVEN) > UNEVEN:
        log.warning(
            "The numbers in the names of the images in %s ascend in uneven steps, so they count as equally far apart; "
            "%s if they are not.",
            folder,
            MENDS,
        )
        return Order(images, even, None, "")
    counts = np.array([float(number - column[0]) for number in column]) / middle
    gaps = int(np.sum(np.round(steps / middle) > 1))
    said = f"{gaps} gap{'s' if gaps > 1 else ''} in the numbers of the names" if gaps else ""
    return Order(images, counts, None, said)


def _columns(names: Sequence[str]) -> list[tuple[int, ...]]:
    """Return the numbers of the names by their places, those that differ; none where the words between them differ."""
    if len({_kind(name) for name in names}) > 1:
        return []
    rows = [[int(number) for number in re.findall(r"[0-9]+", name)] for name in names]
    return [column for column in zip(*rows, strict=True) if len(set(column)) > 1]


def _kind(name: str) -> str:
    return re.sub(r"[0-9]+", "#", name)


def _warn_of_doubts(folder: Path, names: Sequence[str]) -> None:
    """Say where other people would order the images otherwise."""
    kinds = Counter(_kind(name) for name in names)
    columns = _columns(names)
    doubt = ""
    if len(kinds) > 1 and len(kinds) == len(names) > 2:
        doubt = "have no number that orders them, so their order is that of the alphabet"
    elif len(kinds) > 1 and len(names) > 2:
        listed = ", ".join(kind for kind, _ in kinds.most_common(3))
        doubt = f"are of {len(kinds)} kinds ({listed}), one behind the other; give each recording a folder of its own"
    elif _decimals_differ(names):
        doubt = "may be decimals or numbers with parts; they are taken as parts, so that 1.10 comes behind 1.9"
    elif len(columns) > 1 and len(set(columns[-1])) < len(names) and any(b < a for a, b in pairwise(columns[-1])):
        index = next(i for i, (a, b) in enumerate(pairwise(columns[-1])) if b < a)
        doubt = f"start to count again at {names[index + 1]}; give each recording a folder of its own"
    if doubt:
        log.warning("The names of the images in %s %s. To say otherwise, %s.", folder, doubt, MENDS)
    else:
        _warn_of_another_order(folder, names)


def _decimals_differ(names: Sequence[str]) -> bool:
    """Tell whether the names are decimals whose order as such is another."""
    if not all(re.fullmatch(r"[^0-9]*[0-9]+\.[0-9]+[^0-9]*", name) for name in names):
        return False
    values = [float(re.findall(r"[0-9]+\.[0-9]+", name)[0]) for name in names]
    return values != sorted(values)


def _warn_of_another_order(folder: Path, names: Sequence[str]) -> None:
    """Say where a second number would put the images in another order."""
    orders = [column for column in _columns(names) if len(set(column)) == len(names)]
    if any(any(b < a for a, b in pairwise(column)) for column in orders):
        log.warning("The names of the images in %s hold numbers that contradict their order; %s.", folder, MENDS)
