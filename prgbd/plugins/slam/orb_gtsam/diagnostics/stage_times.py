"""Stage times."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


class Stopwatch:
    """Gathers how long named stages take: ``with watch("stage"): ...``."""

    def __init__(self) -> None:
        self._times: dict[str, list[float]] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time one run of a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._times.setdefault(stage, []).append(1000.0 * (time.perf_counter() - start))

    def statistics(self) -> dict[str, dict[str, float]]:
        """Return runs, median, mean and largest time in ms of every stage."""
        return {
            stage: {
                "runs": len(times),
                "median": float(np.median(times)),
                "mean": float(np.mean(times)),
                "max": float(np.max(times)),
            }
            for stage, times in self._times.items()
        }
