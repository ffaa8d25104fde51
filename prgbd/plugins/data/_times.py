"""A file with the times of images: one time a line, a time and a file name, or EuRoC's ``data.csv``."""

from __future__ import annotations

import contextlib
import logging
from datetime import UTC, datetime
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.io.reading import read_text
from prgbd.plugins.data._clocks import EPOCH, UNITS

log = logging.getLogger("prgbd")

LARGEST = 1e20  # of a time in any unit
WHAT = "the times of the images, data.times"


def read_times(path: Path, images: list[Path]) -> tuple[list[Path], NDArray[np.float64]]:
    """Return the images that a file lists, in its order, and their times in seconds.

    Every line is a time, or a time and the name of an image (as in TUM's ``rgb.txt`` or EuRoC's ``data.csv``). A time
    is in seconds, in milli-, micro- or nanoseconds of a Unix clock, or a date with a time of day. Empty lines and
    those that begin with ``#`` do not count.

    Args:
        path: The file.
        images: The images of the folder in the order of their names.

    Raises:
        DataError: If a line is no time, times do not ascend, or the images are not those of the folder.
    """
    times: list[Fraction] = []
    names: list[str] = []
    lines: list[int] = []
    for number, line in enumerate(read_text(path, WHAT).splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        time, rest = _time(words)
        if time is None:
            if not times and number == 1:  # a line of headings
                continue
            raise DataError(f"Line {number} of {path} ({WHAT}) does not begin with a time; mend it.")
        times.append(time)
        names.append(" ".join(rest[:1]))
        lines.append(number)
    chosen = _chosen(path, images, names)
    unit = _unit(times)
    seconds = np.array([float(time / unit) for time in times])
    back = next((i for i, (a, b) in enumerate(pairwise(seconds)) if not b > a), None)
    if back is not None:
        what = "the same time as" if seconds[back] == seconds[back + 1] else "an earlier time than"
        raise DataError(
            f"Line {lines[back + 1]} of {path} ({WHAT}) has {what} the line before; times must ascend, so sort the "
            "lines, and leave images out that have the same time."
        )
    return chosen, seconds


def _time(words: list[str]) -> tuple[Fraction | None, list[str]]:
    """Return the time that a line begins with, and the words behind it."""
    with contextlib.suppress(ValueError):
        if not abs(float(words[0])) < LARGEST:  # not a number is not smaller either
            return None, words
        return Fraction(words[0]), words[1:]
    for text, rest in ((words[0], words[1:]), (" ".join(words[:2]), words[2:])):
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            continue
        if len(text) > len("2000-01-01"):
            return Fraction(moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()), rest
    return None, words


def _unit(times: list[Fraction]) -> int:
    """Return how many of the file's units a second has."""
    return next((unit for unit in UNITS if EPOCH[0] * unit <= times[0] < EPOCH[1] * unit), 1) if times else 1


def _chosen(path: Path, images: list[Path], names: list[str]) -> list[Path]:
    """Return the images that are listed, or all if the file lists times alone."""
    if not any(names):
        if len(names) != len(images):
            raise DataError(
                f"{path} ({WHAT}) has {len(names)} times, but there are {len(images)} images; write one line for each, "
                "or the name of the image behind its time."
            )
        return images
    known = {key: image for image in images for key in (image.stem, image.name)}
    absent = next((name for name in names if Path(name).name not in known), None)
    if absent is not None:
        what = f"'{absent}', which does not lie in {images[0].parent}" if absent else "no name in a line, as in others"
        raise DataError(f"{path} ({WHAT}) has {what}; mend the list or copy the image.")
    chosen = [known[Path(name).name] for name in names]
    if len(chosen) < len(images):
        log.warning("%s lists %d of the %d images; the others are left out.", path, len(chosen), len(images))
    return chosen
