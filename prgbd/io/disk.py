"""What can be written where: full disks, missing permissions and names that are too long, each in one sentence."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prgbd.core.errors import DiskError

_MENDS = {
    errno.ENOSPC: "the disk is full; make room",
    errno.EDQUOT: "the quota is used up; make room",
    errno.EFBIG: "the file is larger than is allowed here; choose another place",
    errno.EACCES: "there is no permission to write; choose another place",
    errno.EPERM: "there is no permission to write; choose another place",
    errno.EROFS: "the disk is read-only; choose another place",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.ELOOP: "its path leads in a circle of links; choose another place",
    errno.ENOTDIR: "a part of its path is a file; choose another place",
    errno.EISDIR: "a folder lies there; choose another place",
    errno.EEXIST: "a file lies where a folder belongs; choose another place",
}
"""What a user can do about a failure to write, by its ``errno``; every other one is a bug."""
_HIDDEN = ("PytorchStreamWriter", "unexpected pos", "iostream error")
"""What torch.save says in place of the system's error."""
LONGEST_NAME = 200
"""Bytes of a file's name: of 255, of which the names of temporary files need some more."""
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def unwritable(error: OSError, path: Path | str | None = None) -> DiskError | None:
    """Return the sentence for a file that could not be written, None if the error is of another kind.

    Args:
        error: What the system said.
        path: The file, where the error itself does not name it.
    """
    mend = _MENDS.get(error.errno or 0)
    if mend is None:
        return None
    return DiskError(f"{path or error.filename or 'A file of the run'} cannot be written: {mend}.")


@contextlib.contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Turn what the system says against writing a file, or a folder with all in it, into one sentence.

    Raises:
        DiskError: If the disk is full, or may not be written to.
    """
    try:
        yield
    except OSError as error:
        # An error that names a file elsewhere is about reading that one.
        own = error.filename is None or _lies_in(os.fsdecode(error.filename), Path(path).parent)
        named = unwritable(error, path) if own else None
        if named is None:
            raise
        raise named from error
    except RuntimeError as error:
        if not any(words in str(error) for words in _HIDDEN):
            raise
        raise DiskError(f"{path} cannot be written: {_MENDS[errno.ENOSPC]}.") from error


def _lies_in(path: str, folder: Path) -> bool:
    """Whether a path lies in a folder, or the folder in it: what cannot be made may be one of its parents."""
    wanted = folder.absolute()
    found = Path(path).absolute()
    return found.is_relative_to(wanted) or wanted.is_relative_to(found)


def require_writable(path: Path | str, option: str) -> None:
    """Find out before the work that a file can be written; missing folders are left to whoever writes it.

    Args:
        path: The file.
        option: What names it.

    Raises:
        DiskError: If it cannot.
    """
    path = Path(path).absolute()
    if os.path.isdir(path):
        raise DiskError(f"{option}: {path} is a folder; name a file in it.")
    if max(len(os.fsencode(part)) for part in path.parts) > LONGEST_NAME:
        raise DiskError(f"{option}: {path} cannot be written: {_MENDS[errno.ENAMETOOLONG]}.")
    there = next(folder for folder in path.parents if os.path.lexists(folder))
    require_writable_folder(there, f"{option}: {path}")


def require_writable_folder(folder: Path, what: str) -> None:
    """Find out whether files can be made in a folder that is there.

    Raises:
        DiskError: If not; ``what`` begins its sentence.
    """
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        named = unwritable(error, what)
        if named is None:
            raise
        raise named from error


def allocated(path: Path, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Make an array in an ``.npy`` file, mapped into memory, whose room on the disk is taken at once.

    In a file with holes a disk that runs full would end the process (SIGBUS) when the array is written to.

    Args:
        path: The file; its folder is made if needed.
        shape: Of the array.
        dtype: Of the array.

    Raises:
        DiskError: If there is no room, or the file cannot be made.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            array: NDArray[Any] = np.lib.format.open_memmap(path, "w+", dtype, shape)
            with open(path, "r+b") as file:
                _allocate(file.fileno(), path.stat().st_size)
        except OSError as error:
            path.unlink(missing_ok=True)
            if error.errno not in _NO_ROOM:
                raise
            free = shutil.disk_usage(path.parent).free
            raise DiskError(
                f"{path} needs {size / 1e6:,.1f} MB and {free / 1e6:,.1f} MB are free; make room, or choose another "
                "place."
            ) from error
    return array


def _allocate(descriptor: int, size: int) -> None:
    if hasattr(os, "posix_fallocate"):  # macOS has none
        os.posix_fallocate(descriptor, 0, size)
