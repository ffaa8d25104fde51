"""Whether a run reached anything: what failed, why, and what that means for the exit code."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from prgbd.core.blame import blaming_plugins
from prgbd.core.data import Sequence
from prgbd.core.errors import DiskError, NothingTrackedError, PartlyFailedError, PrgbdError
from prgbd.core.types import SlamResult
from prgbd.loop.monitor import Monitor

log = logging.getLogger("prgbd")
Look = Callable[[Sequence], Iterable[str]]
"""Looks at a recording and returns a clause for each thing that seems wrong with it."""

LEAST_POSES = 2  # frames with a pose that make a trajectory
MOST_NAMED = 3  # recordings in a sentence


class Failures:
    """Recordings whose errors do not end a run of several.

    Args:
        count: How many recordings the run has.
        monitor: Is told of every error.

    Attributes:
        errors: The error of each recording that failed, by its name.
    """

    def __init__(self, count: int, monitor: Monitor) -> None:
        self.errors: dict[str, PrgbdError] = {}
        self._count, self._monitor = count, monitor

    @contextlib.contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Keep an error of a recording for the end, unless no other recording is left.

        A disk that cannot be written to is no recording's own and ends the run.
        """
        try:
            with blaming_plugins():
                yield
        except DiskError:
            raise
        except PrgbdError as error:
            self.errors[name] = error
            if len(self.errors) == self._count:
                raise
            self._monitor.say(f"  {name} failed, and the others go on: {error}")
            log.error("%s failed", name, exc_info=error)

    def spare(self, sequences: Iterable[Sequence]) -> list[Sequence]:
        """Return the recordings that did not fail."""
        return [sequence for sequence in sequences if sequence.name not in self.errors]

    @property
    def reasons(self) -> dict[str, str]:
        """What each failed recording failed with."""
        return {name: str(error) for name, error in self.errors.items()}


def why_not_tracked(result: SlamResult, sequence: Sequence, look: Look | None = None) -> str | None:
    """Return the most likely reasons why SLAM found no trajectory, in clauses; None if it found one.

    Args:
        result: What was found, without maps that never grew; ``stats`` count those.
        sequence: The recording.
        look: Looks for what is wrong with it.
    """
    if result.tracked_frames >= LEAST_POSES:
        return None
    clauses = [] if look is None else list(look(sequence))
    if result.stats.get("bare_starts", 0) > 1:
        clauses.append(
            "no frame was found again in the map that the one before it had started; check the depth and its unit, "
            "the order of the frames, and that the images show a scene"
        )
    camera = sequence.camera
    return "; ".join(clauses) or (
        "the camera may stand still or only turn, the frames be out of order, the images be too small "
        f"({camera.width}x{camera.height}), or the calibration be wrong"
    )


def verdict(
    loops: list[dict[str, Any]], errors: Mapping[str, str], names: Iterable[str], best_loop: int | None = None
) -> dict[str, Any]:
    """Return ``failed`` and ``failed_sequences`` for the summary.

    Args:
        loops: The entries of the loops.
        errors: What recordings ended with, by their names.
        names: All recordings.
        best_loop: The loop that the run keeps; None for the last.
    """
    kept = next((loop for loop in loops if loop.get("loop") == best_loop), loops[-1] if loops else {})
    poses = kept.get("pose") or {}
    lost = {name: f"nothing was tracked: {pose['failed']}" for name, pose in poses.items() if pose.get("failed")}
    failed = {**errors, **lost}
    if not failed:
        return {"failed": None, "failed_sequences": {}}
    named = [f"{name}: {reason.rstrip('.')}" for name, reason in failed.items()]
    text = "; ".join(named[:MOST_NAMED]) + (f"; and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else "")
    if poses and len(lost) == len(poses):
        first = next(iter(lost))
        text = f"Nothing was tracked in {', '.join(list(lost)[:MOST_NAMED])}: {poses[first]['failed']}"
    else:
        text = f"{len(failed)} of {len({*names, *errors})} recordings failed: {text}"
    return {"failed": f"{text}.", "failed_sequences": failed}


def failure(summary: Mapping[str, Any]) -> PrgbdError | None:
    """Return what a run that reached its end failed with, None if it went well; it has the exit code."""
    if not summary.get("failed"):
        return None
    nothing = str(summary["failed"]).startswith("Nothing was tracked")
    return (NothingTrackedError if nothing else PartlyFailedError)(str(summary["failed"]))
