"""``PredictedDepth``: the files in which a sensor keeps what a network predicted for a recording."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prgbd.core.errors import DataError
from prgbd.io.disk import allocated
from prgbd.io.files import atomic_path, read_json, write_json
from prgbd.loop.sigma_codes import from_codes, to_codes


class PredictedDepth:
    """Inverse depth (4 bytes a pixel), deviations of its logarithm (1 byte) where there are any, and figures.

    Nothing but single frames is read into memory.

    Args:
        folder: Of the files.
        stem: What their names begin with.
        frames: How many the recording has.
    """

    def __init__(self, folder: Path, stem: str, frames: int) -> None:
        self.path = folder / f"{stem}.npy"
        self.sigma_path = folder / f"{stem}-sigma.npy"
        self.figures_path = folder / f"{stem}.json"
        self.frames = frames
        self._opened: dict[Path, NDArray[Any]] = {}

    @property
    def complete(self) -> bool:
        """Whether everything was predicted; the figures are written last."""
        return self.path.is_file() and self.figures_path.is_file()

    @contextlib.contextmanager
    def writing(self) -> Iterator[Writer]:
        """Yield what takes the frames in order; the files are there once the block ends without an exception."""
        with contextlib.ExitStack() as stack:
            writer = Writer(self, stack)
            yield writer
            writer.flush()

    def all_inverse(self) -> NDArray[np.float32]:
        """Return the inverse depth of all frames, (N, h, w) float32, mapped from the file.

        Raises:
            DataError: If it is damaged.
        """
        return self._stored(self.path, np.float32)

    def inverse(self, index: int) -> NDArray[np.float32]:
        """Return the inverse depth of a frame, (h, w) float32.

        Raises:
            DataError: If the file is damaged.
        """
        inverse = np.array(self.all_inverse()[index])
        if not (np.isfinite(inverse).all() and inverse.min() > 0):
            raise self.damaged(f"frame {index} holds values that are no depth")
        return inverse

    def sigma(self, index: int) -> NDArray[np.float32]:
        """Return the standard deviation of the log depth of a frame, (h, w) float32.

        Raises:
            DataError: If the file is damaged.
        """
        return from_codes(np.array(self._stored(self.sigma_path, np.uint8)[index]))

    def read_figures(self) -> Any:
        """Return what ``write_figures`` wrote."""
        return read_json(self.figures_path)

    def write_figures(self, figures: Any) -> None:
        """Write plain figures; the files are complete with them."""
        write_json(self.figures_path, figures)

    def forget(self) -> None:
        """Delete the files."""
        self._opened.clear()
        for path in (self.path, self.sigma_path, self.figures_path):
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # others may have left something there
            self.path.parent.rmdir()

    def damaged(self, why: str, path: Path | None = None) -> DataError:
        """Return the error that says so."""
        return DataError(
            f"The predicted depth {path or self.path} is damaged ({why}); delete it and {self.figures_path.name}, so "
            "that it is predicted again."
        )

    def _stored(self, path: Path, dtype: DTypeLike) -> NDArray[Any]:
        if path not in self._opened:
            self._opened[path] = self._open(path, dtype)
        return self._opened[path]

    def _open(self, path: Path, dtype: DTypeLike) -> NDArray[Any]:
        try:
            stored = np.load(path, mmap_mode="r")
        except (OSError, ValueError, EOFError, SyntaxError) as error:
            raise self.damaged(type(error).__name__, path) from error
        if not isinstance(stored, np.ndarray) or stored.dtype != dtype or stored.ndim != 3 or not stored.size:
            raise self.damaged("it holds something else", path)
        if len(stored) != self.frames:
            raise self.damaged(f"it holds {len(stored)} frames of {self.frames}", path)
        return stored


class Writer:
    """Takes the frames of a recording in order; the first one says what there is and of which size."""

    def __init__(self, files: PredictedDepth, stack: contextlib.ExitStack) -> None:
        self._files, self._stack = files, stack
        self._inverse: NDArray[np.float32] | None = None
        self._codes: NDArray[np.uint8] | None = None

    @property
    def inverse(self) -> NDArray[np.float32]:
        """The inverse depth of the frames so far, (N, h, w)."""
        assert self._inverse is not None  # a sequence has at least one frame
        return self._inverse

    def add(self, index: int, depth: NDArray[np.float32], sigma: NDArray[np.float32] | None) -> None:
        """Take a frame's depth, (h, w), and the deviations of its logarithm where there are any."""
        if self._inverse is None:
            self._inverse = self._allocated(self._files.path, depth.shape, np.float32)
            if sigma is not None:
                self._codes = self._allocated(self._files.sigma_path, depth.shape, np.uint8)
        self._inverse[index] = 1.0 / depth
        if self._codes is not None and sigma is not None:
            self._codes[index] = to_codes(sigma)

    def flush(self) -> None:
        """Bring everything to the disk and let go of it."""
        for written in (self._inverse, self._codes):
            if written is not None:
                written.flush()  # type: ignore[union-attr]
        self._inverse = self._codes = None

    def _allocated(self, path: Path, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        temporary = self._stack.enter_context(atomic_path(path))
        return allocated(temporary, (self._files.frames, *shape), dtype)
