"""Files that are written whole or not at all, and JSON that reads back anywhere."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from prgbd.core.errors import DataError
from prgbd.io.disk import writing
from prgbd.io.reading import read_text

_TEMPORARY = re.compile(r"\..*\.\d+-[0-9a-f]{8}\.tmp(\..*)?", re.DOTALL)


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that replaces it once the block ends without an exception.

    A reader sees the old file or the new one, never half of it, even if the program is killed. The temporary name
    keeps the suffix, because writers such as ``numpy.savez`` choose by it. A folder works too where the target does
    not exist yet (or is empty).

    Args:
        path: The file to write; its folder is made if needed.

    Yields:
        The path to write to, in the same folder.

    Raises:
        DiskError: If the disk is full, or may not be written to.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}-{uuid.uuid4().hex[:8]}.tmp{path.suffix}")
    try:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            if temporary.is_file():
                _flush(temporary)
            os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):  # what could not be made is not there, and the first error counts
            remove(temporary)
        raise


def is_temporary(path: Path) -> bool:
    """Whether a file or folder has a name that only ``atomic_path`` gives."""
    return _TEMPORARY.fullmatch(path.name) is not None


def remove(path: Path) -> None:
    """Remove a file, or a folder with all in it; of a link the link, never what it leads to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Bring the file's content to the disk before its name, so that a power cut cannot leave an empty file."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def to_plain(value: Any) -> Any:
    """Return ``value`` as what JSON knows: numpy scalars and arrays become numbers and lists, NaN and infinity None.

    Raises:
        TypeError: If something in it has no plain form.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): to_plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_plain(v) for v in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"A {type(value).__name__} has no place in JSON: {value!r}")


def write_json(path: Path | str, obj: Any) -> None:
    """Write ``obj`` as indented JSON, whole or not at all; NaN and infinity become null (see ``to_plain``)."""
    text = json.dumps(to_plain(obj), indent=2, ensure_ascii=False, allow_nan=False)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises:
        DataError: If the file cannot be read or is not JSON.
    """
    text = read_text(path, "JSON")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path} is not valid JSON ({error}); delete it so that it is written again.") from error
