"""Reading a run folder (docs/summary-schema.md). Every part but ``summary.json`` may be absent."""

from __future__ import annotations

import io
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from prgbd.core.errors import DataError, PrgbdError
from prgbd.core.types import SlamResult, Trajectory
from prgbd.io.export import load_result
from prgbd.io.files import read_json
from prgbd.io.reading import read_text
from prgbd.io.trajectory_files import read_tum
from prgbd.report.summary_schema import check_summary

T = TypeVar("T")
# What reading a damaged archive of arrays raises, whatever was damaged in it.
_DAMAGED = (
    *(OSError, ValueError, KeyError, EOFError, TypeError, NotImplementedError, RuntimeError, MemoryError),
    *(zipfile.BadZipFile, zlib.error),
)


@dataclass(frozen=True)
class DepthSamples:
    """A few frames with predicted depth.

    Attributes:
        images: (n, H, W, 3) uint8 RGB.
        depth: (n, H, W) float32 prediction.
        truth: (n, H, W) float32 metres with 0 for unknown, or None.
        keys: Sequence name and frame number of each.
        sigma: (n, H, W) float32 predicted standard deviation of log depth, or None.
    """

    images: NDArray[np.uint8]
    depth: NDArray[np.float32]
    truth: NDArray[np.float32] | None
    keys: list[tuple[str, int]]
    sigma: NDArray[np.float32] | None = None


@dataclass
class Run:
    """A run folder; parts are read when asked for, and what is there but unreadable is noted in ``problems``."""

    path: Path
    summary: dict[str, Any]
    problems: list[str] = field(default_factory=list)

    @property
    def loops(self) -> list[dict[str, Any]]:
        """The entries of ``summary.json``'s ``loops``."""
        return list(self.summary.get("loops") or [])

    @property
    def kept_loops(self) -> list[dict[str, Any]]:
        """The loops up to the one whose network and trajectory the run keeps."""
        return kept_loops(self.summary)

    @property
    def entries(self) -> list[dict[str, Any]]:
        """The baselines and the loops, in the order of the tables."""
        return entries(self.summary)

    @property
    def sequences(self) -> list[str]:
        """Names of the sequences: those of the summary, and any that only the loops know."""
        names = list(self.summary.get("sequences") or [])
        for loop in self.loops:
            names += [n for n in (loop.get("pose") or {}) if n not in names]
        return [str(n) for n in names]

    def label(self, loop: dict[str, Any]) -> str:
        """Return the loop's name, with its number where several loops have the same name."""
        name = loop_name(loop)
        twins = sum(loop_name(other) == name for other in self.loops)
        return f"{name} {loop.get('loop')}" if twins > 1 else name

    def folder(self, loop: dict[str, Any]) -> Path:
        """Return the folder of a loop or baseline."""
        if loop.get("folder"):
            return self.path / str(loop["folder"])
        return self.path / "loops" / f"{int(loop.get('loop') or 0):02d}"

    def result(self, loop: dict[str, Any], sequence: str) -> SlamResult | None:
        """Return what SLAM found out about a sequence in a loop."""
        return self._read(self.folder(loop) / "slam" / sequence / "result.npz", load_result)

    def truth(self, sequence: str) -> Trajectory | None:
        """Return the true poses of a sequence."""
        return self._read(self.path / "truth" / f"{sequence}.tum", read_tum)

    def samples(self, loop: dict[str, Any]) -> DepthSamples | None:
        """Return the depth samples of a loop."""
        return self._read(self.folder(loop) / "depth" / "samples.npz", read_samples)

    def losses(self, loop: dict[str, Any]) -> dict[str, NDArray[np.float64]] | None:
        """Return the columns of a loop's ``losses.csv``."""
        return self._read(self.folder(loop) / "training" / "losses.csv", read_losses)

    def text(self, name: str) -> str | None:
        """Return the text of a file of the folder."""
        return self._read(self.path / name, lambda path: read_text(path, "a file of the run"))

    def _read(self, path: Path, reader: Callable[[Path], T]) -> T | None:
        if not os.path.isfile(path):
            return None
        try:
            return reader(path)
        except (PrgbdError, OSError) as error:
            self.problems.append(str(error))
            return None


def open_run(path: Path | str) -> Run:
    """Open a run folder.

    Raises:
        DataError: If there is no readable ``summary.json``.
    """
    path = Path(path)
    if not os.path.isfile(path / "summary.json"):
        raise DataError(f"{path} is no run folder: it has no summary.json; name the folder of a finished run.")
    return Run(path, check_summary(read_json(path / "summary.json"), path / "summary.json"))


def first_and_last_samples(run: Run) -> list[tuple[str, DepthSamples]]:
    """Return name and depth samples of the first and of the kept loop, as far as they are there."""
    found = [(run.label(loop), run.samples(loop)) for loop in run.kept_loops]
    known = [(label, samples) for label, samples in found if samples is not None and len(samples.keys)]
    return known if len(known) < 2 else [known[0], known[-1]]


def read_samples(path: Path) -> DepthSamples:
    """Read ``samples.npz``.

    Raises:
        DataError: If the file is truncated or lacks an array.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        depth = arrays["depth"].astype(np.float32)
        frames = arrays.get("frame_index", np.arange(len(depth)))
        names = np.atleast_1d(arrays.get("sequence", np.array([""])))
        names = names if len(names) == len(depth) else np.repeat(names[:1], len(depth))
        keys = [(str(name), int(frame)) for name, frame in zip(names, frames, strict=True)]
        truth = arrays.get("truth")
        if truth is not None and (truth.shape != depth.shape or truth.dtype.kind not in "fiu"):
            truth = None
        sigma = arrays.get("sigma")
        if sigma is not None and (sigma.shape != depth.shape or sigma.dtype.kind != "f"):
            sigma = None
        images = arrays["images"]
        if depth.ndim != 3 or images.dtype != np.uint8 or images.shape != (*depth.shape, 3) or not depth.size:
            raise ValueError(f"images {images.shape} {images.dtype} for depth {depth.shape}")
        if not np.isfinite(depth).all():
            raise ValueError("depth that is not finite")
        return DepthSamples(images, depth, truth, keys, None if sigma is None else sigma.astype(np.float32))
    except _DAMAGED as error:
        raise DataError(f"{path} is not a whole set of depth samples ({type(error).__name__}: {error}).") from error


def read_losses(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read ``losses.csv`` as columns; an empty cell is NaN, and a half-written last line is dropped.

    Raises:
        DataError: If a cell is not a number.
    """
    whole, _, _ = read_text(path, "the losses of a training").rpartition("\n")
    if not whole:
        return {}
    try:
        columns = pd.read_csv(io.StringIO(whole), dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{path} has a cell that is not a number ({error}).") from error
    return {str(name): values.to_numpy() for name, values in columns.items()}


def entries(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the baselines and the loops of a run, in the order of the tables."""
    return [*(summary.get("baselines") or []), *(summary.get("loops") or [])]


def kept_loops(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the loops up to the one that ``stop.best_loop`` names; all of them where it names none."""
    loops = list(summary.get("loops") or [])
    best = (summary.get("stop") or {}).get("best_loop")
    at = [row for row, loop in enumerate(loops) if loop.get("loop") == best]
    return loops[: at[0] + 1] if at and best is not None else loops


def judged_sequences(summary: dict[str, Any]) -> list[str] | None:
    """Return the recordings that the run's figures are about: the test recordings, None (all) without any.

    A network knows the recordings that it was trained on, so their errors say nothing about other ones.
    """
    return [str(name) for name in summary.get("test_sequences") or []] or None


def mean_pose(loop: dict[str, Any], key: str, sequences: Iterable[str] | None = None) -> float | None:
    """Return the mean of a pose figure over the sequences that have it (or over ``sequences``), None without any."""
    values = _pose_values(loop, key, sequences)
    return float(np.mean(values)) if values else None


def sum_pose(loop: dict[str, Any], key: str, sequences: Iterable[str] | None = None) -> int | None:
    """Return the sum of a pose count over the sequences, None if none has it."""
    values = _pose_values(loop, key, sequences)
    return int(sum(values)) if values else None


def _pose_values(loop: dict[str, Any], key: str, sequences: Iterable[str] | None) -> list[float]:
    pose = loop.get("pose") or {}
    names = pose if sequences is None else sequences
    return [pose[n][key] for n in names if n in pose and isinstance(pose[n].get(key), int | float)]


def compared_sequences(
    first: dict[str, Any], last: dict[str, Any], sequences: Iterable[str] | None = None
) -> list[str]:
    """Return the sequences with an ATE in both loops, of ``sequences`` or all: means must compare like with like."""
    a, b = first.get("pose") or {}, last.get("pose") or {}
    names = [n for n in (a if sequences is None else sequences) if n in a and n in b]
    return [n for n in names if a[n].get("ate_rmse") is not None and b[n].get("ate_rmse") is not None]


def loop_name(loop: dict[str, Any]) -> str:
    """Return the loop's name, or ``loop k``, and whether it was rolled back."""
    name = str(loop.get("name") or f"loop {loop.get('loop', '?')}")
    return f"{name}, rolled back" if loop.get("rolled_back") else name
