"""Tables in text files of the user's: lines of words or of numbers, with ``#`` before comments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.io.reading import read_text

# No time, length or focal length is larger, and its square is still a number.
LARGEST = 1e20


def text_lines(path: Path | str, what: str) -> list[tuple[int, list[str]]]:
    """Return the number and the words of each line that is neither empty nor a comment.

    Words are separated by spaces, tabs or commas.

    Args:
        path: The file.
        what: What it is, for messages.

    Raises:
        DataError: If the file is absent or no text.
    """
    lines = enumerate(read_text(path, what).split("\n"), 1)
    words = ((number, line.replace(",", " ").split()) for number, line in lines)
    return [(number, w) for number, w in words if w and not w[0].startswith("#")]


def read_table(path: Path | str, columns: int, what: str, finite: bool = False) -> NDArray[np.float64]:
    """Read lines of numbers, (N, columns); empty lines and lines that begin with ``#`` do not count.

    Args:
        path: The file.
        columns: How many numbers each line has.
        what: What they are, for messages.
        finite: Whether NaN and infinity are refused here; else they are left to the caller.

    Raises:
        DataError: If the file is absent or a line is something else; the message names the line.
    """
    rows: list[NDArray[np.float64]] = []
    for number, words in text_lines(path, what):
        row = as_numbers(words)
        if row is None or len(row) != columns:
            mend = _mend(words, columns, not rows)
            raise DataError(f"Line {number} of {path} is not {columns} numbers ({what}); {mend}.")
        if finite and not np.isfinite(row).all():
            raise DataError(f"Line {number} of {path} has a number that is not finite ({what}); check the file.")
        if (np.abs(row[np.isfinite(row)]) > LARGEST).any():
            raise DataError(f"Line {number} of {path} has a number beyond {LARGEST:g} ({what}); check the file.")
        rows.append(row)
    return np.array(rows, np.float64).reshape(-1, columns)


def as_numbers(words: list[str]) -> NDArray[np.float64] | None:
    """Return words as numbers, or None where one is none."""
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        return None


def _mend(words: list[str], columns: int, first: bool) -> str:
    """Say what such a line most likely is."""
    if first and not any(as_numbers([word]) is not None for word in words):
        return "it looks like a header: put '#' before it"
    if len(words) == 2 * columns and as_numbers(words) is not None:
        return "numbers must have decimal points, not commas"
    return "check the file"
