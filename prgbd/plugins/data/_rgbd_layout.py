"""The layout of the TUM RGB-D data set, which many recorders write: lists of times and files, true poses by time."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from prgbd.core.errors import DataError
from prgbd.io.text_tables import as_numbers, read_table, text_lines
from prgbd.io.time_base import REACH, Clock, common_clock, in_seconds, no_meeting
from prgbd.io.trajectory_files import as_poses

log = logging.getLogger("prgbd")

Times = NDArray[np.float64]

MAX_GAP = 0.1  # seconds between two poses of the motion capture to interpolate over
LOW_RATE = 2 * REACH  # seconds between true poses from which images lie between them, not beside them
LOWEST_RATE = 1.0  # seconds between true poses, beyond which the way between them is not known
STEPS = 3.0  # of a low rate may be missing
FEW = 0.5  # of the images with depth


def read_list(path: Path, what: str) -> tuple[Times, list[Path]]:
    """Return the time stamps and files of a list, in order of time.

    Raises:
        DataError: If a line is something else, or there is none.
    """
    pairs = []
    for number, words in text_lines(path, f"list of {what} images"):
        time = as_numbers(words[:1])
        if len(words) != 2 or time is None or not np.isfinite(time[0]):
            mend = "write decimal points, not commas" if as_numbers(words[:2]) is not None else "copy the file anew"
            raise DataError(f"Line {number} of {path} is not a time stamp and a file name; {mend}.")
        pairs.append((float(time[0]), path.parent / words[1]))
    if not pairs:
        raise DataError(f"{path} lists no images; copy the file anew.")
    return sorted_by_time(pairs)


def read_associations(path: Path, depth: str) -> tuple[Times, list[Path], list[Path]]:
    """Return the times, colour images and depth files of a list of pairs, in order of time.

    Args:
        path: The list: lines of a time, a file, a time and a file, colour before depth or the other way round.
        depth: The folder of the depth files, which tells which is which.

    Raises:
        DataError: If a line is something else, or there is none.
    """
    pairs = []
    for number, words in text_lines(path, "pairs of images and depth"):
        times = as_numbers(words[::2])
        if len(words) != 4 or times is None or not np.isfinite(times).all():
            raise DataError(f"Line {number} of {path} is not a time, an image, a time and a depth file; mend it.")
        one, other = (float(times[0]), words[1]), (float(times[1]), words[3])
        turned = one[1].startswith(f"{depth}/") and not other[1].startswith(f"{depth}/")
        (time, image), (_, file) = (other, one) if turned else (one, other)
        pairs.append((time, path.parent / image, path.parent / file))
    if not pairs:
        raise DataError(f"{path} lists no pairs; copy the file anew.")
    pairs.sort(key=lambda pair: pair[0])
    return np.array([pair[0] for pair in pairs]), [pair[1] for pair in pairs], [pair[2] for pair in pairs]


def sorted_by_time(pairs: list[tuple[float, Path]]) -> tuple[Times, list[Path]]:
    """Return times and files in order of time."""
    pairs = sorted(pairs, key=lambda pair: pair[0])
    return np.array([time for time, _ in pairs]), [path for _, path in pairs]


def own_seconds(times: Times, where: Path) -> Times:
    """Return a recording's own times in seconds, and say so where they were in another unit."""
    return _said(in_seconds(times), f"{where}: ").seconds(times)


def depth_of_images(depth_times: Times, depths: list[Path], times: Times, where: Path) -> list[Path | None]:
    """Return the depth file of each image: the nearest within 0.02 s, each serving only once.

    Raises:
        DataError: If no image has one.
    """
    found_files = [None if i < 0 else depths[i] for i in partners_of_images(depth_times, times, where)]
    warn_if_few(found_files, where)
    return found_files


def partners_of_images(depth_times: Times, times: Times, where: Path) -> NDArray[np.int64]:
    """Return the number of the depth image of each image, (N,), -1 where there is none within 0.02 s.

    Raises:
        DataError: If no image has one.
    """
    what = f"the depth images of {where}"
    clock = _said(common_clock(depth_times, times, what))
    partners = _partners(clock.seconds(depth_times), times)
    if (partners < 0).all():
        raise DataError(
            f"None of the {len(times)} images has a depth image within {REACH:g} s. "
            + no_meeting(depth_times, times, what)
        )
    return partners


def warn_if_few(depths: Sequence[Any], where: Path) -> None:
    """Say so where less than half of the images have depth."""
    found = sum(path is not None for path in depths)
    if found < FEW * len(depths):
        log.warning("Only %d of the %d colour images of %s have a depth image.", found, len(depths), where)


def true_poses(path: Path, times: Times) -> NDArray[np.float64] | None:
    """Return the true poses (N, 4, 4) of ``groundtruth.txt`` at the given times; None without a file.

    Raises:
        DataError: If the file is malformed.
    """
    if not path.is_file():
        return None
    return poses_at(read_table(path, 8, "time stamp, translation and quaternion", finite=True), times, path)


def poses_at(rows: NDArray[np.float64], times: Times, path: Path) -> NDArray[np.float64] | None:
    """Return the true poses (N, 4, 4) at the given times, NaN where they are not known; None if none is.

    Poses of a motion capture are interpolated over at most 0.1 s, and only for images within 0.02 s of one. Poses of a
    lower rate are interpolated between neighbours, over at most three of their steps; beyond one second between them,
    only images within 0.02 s of one have a pose.

    Args:
        rows: (R, 8) time, translation and quaternion x, y, z, w, in any order.
        times: (N,) seconds of the images, ascending.
        path: Their file, for messages.

    Raises:
        DataError: If a row is no pose.
    """
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    rows = rows[np.append(True, np.diff(rows[:, 0]) > 0)] if len(rows) else rows
    as_poses(rows, path)
    if len(rows) < 2:
        log.warning("%s has %d poses, so there are no true poses.", path, len(rows))
        return None
    what = f"the true poses of {path}"
    try:
        rows[:, 0] = _said(common_clock(rows[:, 0], times, what)).seconds(rows[:, 0])
    except DataError as error:
        log.warning("%s There are no true poses.", error)
        return None
    known = _have_pose(rows[:, 0], times, what)
    if not known.any():
        log.warning("%s There are no true poses.", no_meeting(rows[:, 0], times, what))
        return None
    at = times[known]
    out = np.full((len(times), 4, 4), np.nan)
    out[known] = np.eye(4)
    out[known, :3, :3] = Slerp(rows[:, 0], Rotation.from_quat(rows[:, 4:]))(at).as_matrix()
    out[known, :3, 3] = np.stack([np.interp(at, rows[:, 0], rows[:, 1 + i]) for i in range(3)], axis=1)
    return out


def _have_pose(among: Times, times: Times, what: str) -> NDArray[np.bool_]:
    """Return which images have a true pose: near enough to one, or between two of a lower rate."""
    after = np.clip(np.searchsorted(among, times, side="right"), 1, len(among) - 1)
    gap = among[after] - among[after - 1]
    inside = (times >= among[0]) & (times <= among[-1])
    beside = np.abs(among[_nearest(among, times)] - times) <= REACH
    step = float(np.quantile(np.diff(among), 0.5, method="lower"))
    if step <= LOW_RATE:
        return inside & (gap <= MAX_GAP) & beside
    if step > LOWEST_RATE:
        log.warning("Of %s there is only one every %.3g s: only images beside one have a true pose.", what, step)
        return inside & beside
    log.warning("Of %s there is one every %.3g s: those of the images between are interpolated.", what, step)
    return inside & ((gap <= STEPS * step) | beside)


def _said(clock: Clock, where: str = "") -> Clock:
    if clock.note:
        log.warning("%s%s", where, clock.note)
    return clock


def _nearest(among: Times, times: Times) -> NDArray[np.int64]:
    """Return for each time the index of the nearest of the ascending times ``among``."""
    after = np.clip(np.searchsorted(among, times), 1, max(len(among) - 1, 1))
    if len(among) == 1:
        return np.zeros(len(times), np.int64)
    return np.where(times - among[after - 1] <= among[after] - times, after - 1, after).astype(np.int64)


def _partners(among: Times, times: Times) -> NDArray[np.int64]:
    """Return for each time the index of its partner in ``among`` within 0.02 s, or -1; a partner serves only once."""
    nearest = _nearest(among, times)
    difference = np.abs(among[nearest] - times)
    closest = np.full(len(among), np.inf)
    np.minimum.at(closest, nearest, difference)
    return np.where((difference <= REACH) & (difference == closest[nearest]), nearest, -1)
