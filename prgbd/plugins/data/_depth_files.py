"""Depth images of a sensor: from the numbers in their files to metres, with what had to be assumed said once."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.reading import require_file
from prgbd.plugins.data._images import decode_file

log = logging.getLogger("prgbd")

SUFFIXES = (".png", ".tif", ".tiff", ".npy", ".exr")
CHANNELS = ("Z", "V", "Y", "R", "depth.V", "Depth.Z", "depth.Z")  # in which programs put depth into EXR files
MILLIMETRES, METRES = 1000.0, 1.0  # levels in a metre of whole numbers and of others, unless told
SAME_SHAPE = 0.01  # relative difference of two aspect ratios
HARDLY = 0.1  # of the pixels must be negative to be worth a word
PILED_UP = (0.02, 0.9)  # share of the known pixels at one largest value that looks like a mark of the unknown


@dataclass(frozen=True)
class DepthFormat:
    """What the numbers in depth files mean.

    Attributes:
        levels_per_metre: Grey levels in one metre: 1000 where a level is a millimetre, 5000 in the TUM data set. None
            takes whole numbers as millimetres and others as metres.
        invalid: Values that mean "unknown", besides 0 and the largest value that the file's type can hold.

    Raises:
        ConfigError: If a metre has less than one level.
    """

    levels_per_metre: float | None = None
    invalid: tuple[float, ...] = (0,)

    def __post_init__(self) -> None:
        levels = self.levels_per_metre
        if levels is not None and not 1 <= levels < np.inf:
            inverse = f"; do you mean {1 / levels:g}?" if 0 < levels < 1 else "."
            raise ConfigError(
                f"The option depth_levels_per_metre is {levels:g}; it counts the grey levels in one metre (1000 for "
                f"millimetres, 5000 for TUM's files, 1 for files in metres), not the metres of one level{inverse}"
            )

    def levels_in(self, files: Iterable[Path | None]) -> float | None:
        """Return the grey levels in one metre of some files, None where only their content tells."""
        whole = all(path is None or path.suffix.lower() == ".png" for path in files)
        return self.levels_per_metre or (MILLIMETRES if whole else None)


class DepthReader:
    """Reads the depth files of one recording.

    Args:
        name: Of the recording, for messages.
        size: (width, height) of the colour images, pixels.
        form: What the numbers mean.
    """

    def __init__(self, name: str, size: tuple[int, int], form: DepthFormat) -> None:
        self._name, self._size, self._format = name, size, form
        self._said: set[str] = set()

    def read(self, path: Path) -> NDArray[np.float32]:
        """Return the depth of a file, (H, W) float32 metres with 0 where unknown, in the size of the colour images.

        Raises:
            DataError: If the file is absent, truncated, of another shape, or holds no depth; the message names it.
        """
        return self.metres(read_levels(path), path)

    def metres(self, levels: NDArray[Any], path: Path | str) -> NDArray[np.float32]:
        """Do as ``read`` does for the numbers (h, w) of a depth image; ``path`` names it.

        Raises:
            DataError: If it has another shape than the colour images.
        """
        known = self._known(levels, path)
        whole = levels.dtype.kind in "ui"
        per_metre = self._format.levels_per_metre or (MILLIMETRES if whole else METRES)
        with np.errstate(over="ignore", invalid="ignore"):
            depth = levels.astype(np.float32) * np.float32(1 / per_metre)
        depth[~known | ~np.isfinite(depth)] = 0.0
        return self._resized(depth, path)

    def _known(self, levels: NDArray[Any], path: Path | str) -> NDArray[np.bool_]:
        """Return which pixels have a depth."""
        largest = np.iinfo(levels.dtype).max if levels.dtype.kind in "ui" else np.finfo(levels.dtype).max
        negative, saturated = levels < 0, levels == largest
        known = np.isfinite(levels) & ~negative & ~saturated & ~np.isin(levels, (0, *self._format.invalid))
        if saturated.any() and largest not in self._format.invalid:
            self._say(
                "saturated",
                f"{saturated.mean():.1%} of {path} is {largest:g}, the largest value it can hold; taken as unknown",
            )
        if negative.mean() > HARDLY:
            self._say("negative", f"{negative.mean():.0%} of {path} is negative; taken as unknown")
        self._look_for_marks(levels[known], path)
        return known

    def _look_for_marks(self, values: NDArray[Any], path: Path | str) -> None:
        """Say so where many pixels share the largest value, which no surface does."""
        top = values.max(initial=0)
        share = float((values == top).mean()) if len(values) else 0.0
        if PILED_UP[0] < share < PILED_UP[1]:
            listed = ",".join(f"{value:g}" for value in dict.fromkeys((*self._format.invalid, float(top))))
            self._say(
                "mark",
                f"{share:.0%} of the depth in {path} is {top:g}, its largest value; if that means unknown, set "
                f"data.depth_invalid=[{listed}]",
            )

    def _resized(self, depth: NDArray[np.float32], path: Path | str) -> NDArray[np.float32]:
        height, width = depth.shape
        if (width, height) == self._size:
            return depth
        theirs = f"{path} is {width}x{height} pixels, but the colour images are {self._size[0]}x{self._size[1]}"
        if abs(width * self._size[1] / (height * self._size[0]) - 1) > SAME_SHAPE:
            raise DataError(f"{theirs}, of another aspect ratio; register the depth to the colour images.")
        self._say("size", f"{theirs}: it is resized, and must be registered to them")
        return np.asarray(cv2.resize(depth, self._size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)

    def _say(self, what: str, words: str) -> None:
        if what not in self._said:
            self._said.add(what)
            log.warning("Depth of '%s': %s.", self._name, words)


def read_levels(path: Path) -> NDArray[Any]:
    """Read the numbers of a depth file as they are, (H, W) of a type of 16 bits or more.

    Raises:
        DataError: If the file is absent, truncated, or holds no depth; the message names it.
    """
    suffix = path.suffix.lower()
    levels = (
        _npy(path) if suffix == ".npy" else _exr(path) if suffix == ".exr" else decode_file(path, cv2.IMREAD_UNCHANGED)
    )
    if levels.ndim == 3 and levels.shape[-1] in (3, 4) and (levels[..., :3] == levels[..., :1]).all():
        levels = levels[..., 0]
    elif levels.ndim > 2:
        levels = levels.reshape([side for side in levels.shape if side != 1] or [1])
    if levels.ndim != 2 or levels.size == 0 or levels.dtype.kind not in "uif":
        kind = f"{'x'.join(map(str, levels.shape))} of {levels.dtype}"
        raise DataError(f"{path} holds {kind}, which is no depth; it must be one number per pixel.")
    if levels.dtype.itemsize == 1:
        raise DataError(f"{path} has 8 bits a pixel: a picture of depth, not depth; take the 16-bit or float files.")
    return levels


def _npy(path: Path) -> NDArray[Any]:
    """Read an array that NumPy saved; mapped first, so that a wrong header does not ask for all memory."""
    try:
        return np.array(np.load(require_file(path, "depth"), mmap_mode="r", allow_pickle=False))
    except DataError:
        raise
    except Exception as error:  # NumPy's parser of headers raises many kinds
        raise DataError(f"{path} is no array of numbers that numpy.save wrote; copy the file anew.") from error


def _exr(path: Path) -> NDArray[Any]:
    try:
        import OpenEXR
    except ImportError:
        raise DataError(f"Reading {path} needs the extra 'exr'; pip install 'prgbd[exr]'.") from None
    try:
        channels = OpenEXR.File(str(require_file(path, "depth")), separate_channels=True).channels()
        found = {name: np.asarray(channel.pixels) for name, channel in channels.items()}
    except DataError:
        raise
    except Exception as error:  # the library has no class of its own for damaged files
        raise DataError(f"{path} is truncated or no EXR image; copy the file anew.") from error
    if len(found) == 1:
        return next(iter(found.values()))
    chosen = next((name for name in CHANNELS if name in found), None)
    if chosen is None:
        raise DataError(
            f"{path} has the channels {', '.join(found) or 'none'}; depth must be one channel, or be called Z."
        )
    return found[chosen]
