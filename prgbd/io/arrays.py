"""Arrays from ``.npz`` files that people pass on: nothing is used before all of it is known to be what it should be."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.io.reading import require_file

# Real files are a half to a tenth of what is in them. A small file that claims gigabytes is damaged, or made to harm.
_MOST_EXPANSION = 300
_SMALL = 2**28
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@dataclass(frozen=True)
class Entry:
    """What an array of a file must be.

    Attributes:
        kinds: Letters of NumPy's kinds of types that it may have, such as ``"iu"`` for whole numbers.
        shape: Its lengths; a name stands for a length that is the same wherever the name is used.
        least: Its smallest number.
        most: Its largest one.
        below: A name of ``shape`` in place of ``most``: the numbers count what has that length.
        required: Whether the file must have it.
    """

    kinds: str
    shape: tuple[int | str, ...]
    least: float = -1e12
    most: float = 1e12
    below: str = ""
    required: bool = True


TEXT = Entry("U", ())


def read_arrays(path: Path | str, schema: Mapping[str, Entry], what: str) -> dict[str, NDArray[Any]]:
    """Read the arrays that a schema names; others are left alone.

    Args:
        path: The file.
        schema: What each array must be, by its name.
        what: What the file is, for the messages, such as ``"map of orb_gtsam"``.

    Returns:
        The arrays, with finite numbers within their limits; those that count something else's rows are int64.

    Raises:
        DataError: If the file is absent, damaged, or holds something else; the message names the array.
    """
    path = require_file(path, f"a {what}")
    try:
        with zipfile.ZipFile(path) as archive:
            known = set(archive.namelist())
            present = [name for name, entry in schema.items() if entry.required or f"{name}.npy" in known]
            lengths: dict[str, int] = {}
            size = sum(_size(archive, name, schema[name], lengths) for name in present)
            if size > max(_SMALL, _MOST_EXPANSION * path.stat().st_size):
                raise ValueError(f"it claims to hold {size / 2**30:.0f} GiB")
            arrays = {name: _read(archive, name) for name in present}
        for name, array in arrays.items():
            _check_values(name, array, schema[name], lengths)
            if schema[name].below:
                arrays[name] = array.astype(np.int64, copy=False)
    except Exception as error:  # what the decoders raise for bytes that are not theirs is theirs to choose
        raise DataError(f"{path} is not a whole {what} ({_reason(error)}); make it anew.") from error
    return arrays


def _size(archive: zipfile.ZipFile, name: str, entry: Entry, lengths: dict[str, int]) -> int:
    """Return the bytes of an array whose type and shape are right; only its header is read."""
    with archive.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"'{name}' is written in version {version} of NumPy's format")
        shape, _, dtype = _HEADERS[version](file)
    strange = dtype.kind == "f" and dtype.itemsize not in (4, 8)  # half and long ones, which few functions take
    if dtype.kind not in entry.kinds or strange or not dtype.isnative:
        raise ValueError(f"'{name}' holds {dtype}")
    named = zip(shape, entry.shape, strict=False)
    fits = len(shape) == len(entry.shape) and all(
        length == (lengths.setdefault(wanted, length) if isinstance(wanted, str) else wanted)
        for length, wanted in named
    )
    if not fits:
        meant = ", ".join(str(lengths.get(str(wanted), wanted)) for wanted in entry.shape)
        raise ValueError(f"'{name}' has the shape {shape} instead of ({meant})")
    return math.prod(shape) * dtype.itemsize


def _read(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    with archive.open(f"{name}.npy") as file:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def _check_values(name: str, array: NDArray[Any], entry: Entry, lengths: Mapping[str, int]) -> None:
    if array.dtype.kind not in "fiu" or not array.size:
        return
    least, most = array.min(), array.max()
    if not (np.isfinite(least) and np.isfinite(most)):
        raise ValueError(f"'{name}' has values that are not finite")
    limit = lengths[entry.below] - 1 if entry.below else entry.most
    for value, wrong in ((least, least < entry.least), (most, most > limit)):
        if wrong:
            raise ValueError(f"'{name}' has the value {value:g}, which is out of range")


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else f"{text[:200]} ..."
