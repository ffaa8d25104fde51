"""``summary.json`` and what is written from it."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

from prgbd.core.data import Sequence
from prgbd.core.types import Trajectory
from prgbd.io.files import write_json
from prgbd.io.trajectory_files import write_tum
from prgbd.loop.outcome import verdict
from prgbd.loop.store import SUMMARY, RunStore
from prgbd.version import __version__

SCHEMA = 1
_PACKAGES = ("torch", "lightning", "numpy", "opencv-python-headless", "gtsam", "numba", "evo", "hydra-core")


@dataclass(frozen=True)
class RunIdentity:
    """What a run is about, for the head of its summary.

    Attributes:
        task: Name of the task.
        slam: Id of the SLAM plug-in, "" for none.
        depth: Id of the depth plug-in, "" for none.
        data: Id of the data plug-in.
        seed: Seed of everything random.
    """

    task: str
    slam: str
    depth: str
    data: str
    seed: int


def write_summary(
    store: RunStore,
    identity: RunIdentity,
    sequences: list[Sequence],
    loops: list[dict[str, Any]],
    *,
    stop: Mapping[str, Any] | None = None,
    seconds: float | None = None,
    errors: Mapping[str, str] | None = None,
    more: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write ``summary.json`` (schema: docs/summary-schema.md) and return it.

    Args:
        store: The run.
        identity: What the run is about.
        sequences: All recordings, test recordings included.
        loops: One entry per SLAM run over the sequences, first to last.
        stop: Why the loop ended and which loop was best.
        seconds: Time that the steps of the run took.
        errors: What recordings failed with, by their names.
        more: Further entries of the task.
    """
    names = [sequence.name for sequence in sequences]
    summary = {
        "schema": SCHEMA,
        "prgbd": __version__,
        "task": identity.task,
        "slam": identity.slam,
        "depth": identity.depth,
        "data": identity.data,
        "sequences": names,
        "seed": identity.seed,
        "loops": loops,
        **verdict(loops, errors or {}, names, (stop or {}).get("best_loop")),
        "stop": dict(stop) if stop is not None else None,
        "versions": versions(),
        "threads": torch.get_num_threads(),
        "seconds": seconds,
        **(more or {}),
    }
    write_json(store.path(SUMMARY), summary)
    return summary


def write_results(store: RunStore, summary: Mapping[str, Any]) -> Path:
    """Write ``metrics.csv`` and ``report.html`` from the summary of a finished run; return where the report lies."""
    from prgbd.report.page import write_report
    from prgbd.report.tables import write_metrics_csv

    write_metrics_csv(dict(summary), store.path("metrics.csv"))
    write_report(store.folder)
    return store.path("report.html")


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def write_truth(store: RunStore, sequences: list[Sequence]) -> None:
    """Write the true trajectory of every recording that has one, ``truth/SEQ.tum``."""
    import numpy as np

    for sequence in sequences:
        poses = sequence.poses
        if poses is None:
            continue
        known = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
        write_tum(
            Trajectory(known.astype(np.int64), sequence.timestamps[known], poses[known]),
            store.path("truth", f"{sequence.name}.tum"),
        )
