"""Frames that repeat the one before, as where a recording of 30 Hz was put into a file of 60."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError

log = logging.getLogger("prgbd")

STRETCHES, LENGTH = 5, 13  # of consecutive frames that are looked at first
WIDTH = 160  # pixels of the grey pictures that are compared
CELL = 8  # pixels of these pictures that are compared together
MOVES = 4.0  # grey levels by which a cell differs at least where the camera moves
STANDS = 0.25  # of the change before and after it: a frame that changes less repeats the one before
LONGEST = 5  # repeats in a row; where the picture stands for longer, the camera stands
SPAN = 2 * LONGEST + 1  # frames around one that tell how fast the picture moves there
SHARE = 0.3  # of the frames repeat at least; a camera that is late now and then repeats fewer, which does little harm

CHOICES = ("leave_out", "keep")

Read = Callable[[int], NDArray[np.uint8]]


def without_repeats(
    read: Read, count: int, where: str, repeats: str, place: Callable[[int], int] | None = None
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the frames of a recording that do not repeat the one before, and clauses that say what is left out.

    A few short stretches are looked at first; the whole recording is read only if frames repeat there.

    Args:
        read: Returns a frame, (H, W, 3) uint8 RGB.
        count: Number of frames.
        where: The recording, for messages.
        repeats: "leave_out" or "keep".
        place: Returns a frame near the given one from which reading in order is cheap; None if all are.

    Raises:
        ConfigError: If ``repeats`` is neither.
    """
    if repeats not in CHOICES:
        raise ConfigError(f"data.repeats={repeats} is unknown; choose from {', '.join(CHOICES)}.")
    every = np.arange(count)
    if repeats == "keep" or count < LENGTH:
        return every, ()
    starts = np.unique(np.linspace(0, count - LENGTH, STRETCHES).astype(int))
    starts = np.unique([start if place is None else place(int(start)) for start in starts])
    marks = [repeated(_changes(read, range(start, min(start + LENGTH, count)))) for start in starts]
    if np.mean(np.concatenate(marks)) < SHARE / 2:  # the stretches are few
        return every, ()
    stay = ~repeated(_changes(read, range(count)))
    left_out = int(np.count_nonzero(~stay))
    if left_out < SHARE * count:
        return every, ()
    log.warning(
        "%d of the %d frames of %s repeat the one before, as where a recording was converted to a higher frame rate: "
        "they are left out (data.repeats=keep keeps them).",
        left_out,
        count,
        where,
    )
    return every[stay], (f"{left_out} repeated frames left out",)


def repeated(changes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which frames repeat the one before.

    The picture must stand for a few frames only, and move right before and behind: a camera that stands, slows down
    or moves slowly repeats nothing.

    Args:
        changes: (N,) grey levels by which each frame differs from the one before, NaN where that is not known.

    Returns:
        (N,).
    """
    marks = np.zeros(len(changes), bool)
    changes = np.append(changes, np.inf)  # beyond the first and the last frame nothing is known: let it move
    changes[0] = np.inf
    around = np.lib.stride_tricks.sliding_window_view(np.pad(np.where(np.isfinite(changes), changes, 0), LONGEST), SPAN)
    moving = changes >= np.maximum(MOVES, STANDS * around.max(axis=1))  # a repeat shows the noise of compression
    for before, after in itertools.pairwise(np.flatnonzero(moving)):
        run = changes[before + 1 : after]
        bound = min(changes[before], changes[after])
        if 1 <= len(run) <= LONGEST and np.isfinite(bound) and np.all(run < STANDS * bound):
            marks[before + 1 : after] = True
    return marks


def _changes(read: Read, frames: range) -> NDArray[np.float64]:
    """Return how much each frame differs from the one before, (len(frames),), NaN where that is not known.

    It is the mean grey levels in the cell of the picture that differs most: in a repeat nothing changes anywhere.
    """
    changes = np.full(len(frames), np.nan)
    last = None
    for at, number in enumerate(frames):
        try:
            grey = _small(read(number))
        except DataError:  # the run itself will name it
            grey = None
        if grey is not None and last is not None and grey.shape == last.shape:
            change = cv2.absdiff(grey, last)
            cells = (max(1, change.shape[1] // CELL), max(1, change.shape[0] // CELL))
            changes[at] = float(cv2.resize(change, cells, interpolation=cv2.INTER_AREA).max())
        last = grey
    return changes


def _small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height = max(1, round(image.shape[0] * WIDTH / image.shape[1]))
    small = cv2.resize(image, (WIDTH, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), np.uint8)
