"""Arrays that grow together, and give back the memory of rows that nobody needs any more."""

from __future__ import annotations

import math
import mmap

import numpy as np
from numpy.typing import DTypeLike, NDArray

_FIRST_ROWS = 16
# Columns with more numbers per row than this are heavy.
_LIGHT = 16
# Memory of these can be given back piece by piece; elsewhere (Windows) it is kept until the columns go.
_CAN_RELEASE = hasattr(mmap, "MAP_PRIVATE") and hasattr(mmap, "MADV_DONTNEED")


class Columns:
    """Arrays that grow together along their first axis by doubling."""

    def __init__(self, **columns: tuple[tuple[int, ...], type, float]) -> None:
        """Declare columns as ``name=(shape of a row, dtype, fill value)``."""
        self.count = 0
        # Rows of one number are not worth the trouble, and say what became of a row that was released.
        self._heavy = [name for name, (shape, _, _) in columns.items() if math.prod(shape) > _LIGHT]
        self._fill = {name: fill for name, (_, _, fill) in columns.items()}
        self._buffers: dict[str, mmap.mmap] = {}
        self._released = np.zeros(_FIRST_ROWS, np.bool_)
        for name, (shape, dtype, _) in columns.items():
            setattr(self, name, self._allocate(name, (_FIRST_ROWS, *shape), dtype))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(self._fill)

    def _allocate(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[np.generic]:
        """Return zeros that take no memory before they are written to."""
        if not _CAN_RELEASE:
            return np.zeros(shape, dtype)
        size = math.prod(shape) * np.dtype(dtype).itemsize
        self._buffers[name] = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        return np.frombuffer(self._buffers[name], dtype).reshape(shape)

    def grow(self, rows: int) -> int:
        """Add ``rows`` rows of fill values and return the first one's number."""
        first, needed = self.count, self.count + rows
        if needed > len(self._released):
            self._enlarge(max(needed, 2 * len(self._released)))
        for name, fill in self._fill.items():
            getattr(self, name)[first:needed] = fill
        self.count = needed
        return first

    def _enlarge(self, rows: int) -> None:
        kept = np.flatnonzero(~self._released[: self.count])
        runs = np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1)
        for name in self._fill:
            array = getattr(self, name)
            larger = self._allocate(name, (rows, *array.shape[1:]), array.dtype)
            for run in [np.arange(self.count)] if name not in self._heavy else runs:
                if len(run):
                    larger[run[0] : run[-1] + 1] = array[run[0] : run[-1] + 1]
            setattr(self, name, larger)
        released = np.zeros(rows, np.bool_)
        released[: self.count] = self._released[: self.count]
        self._released = released

    def release(self, row: int) -> None:
        """Give back the memory of a row's heavy columns, which become zero, or keep their content for the time being.

        Memory comes in pages, so a page goes with the last of the rows that share it.
        """
        if not _CAN_RELEASE:
            return
        self._released[row] = True
        for name in self._heavy:
            array = getattr(self, name)
            width = array.nbytes // len(array)
            first, last = row * width // mmap.PAGESIZE, -(-(row + 1) * width // mmap.PAGESIZE)
            if not self._released[first * mmap.PAGESIZE // width : row].all():
                first += 1
            after = min(-(-last * mmap.PAGESIZE // width), len(array))
            if not self._released[row + 1 : after].all():
                last -= 1
            if last > first:
                self._buffers[name].madvise(mmap.MADV_DONTNEED, first * mmap.PAGESIZE, (last - first) * mmap.PAGESIZE)

    def clear(self, rows: NDArray[np.int64]) -> None:
        """Set rows to their fill values."""
        for name, fill in self._fill.items():
            getattr(self, name)[rows] = fill
