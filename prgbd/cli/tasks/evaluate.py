"""``task=evaluate``: a network's depth, and / or a trajectory file, against the truth of recordings."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from prgbd.cli.job import Job
from prgbd.cli.task_options import EvaluateTask
from prgbd.cli.tasks.depth import evaluate as evaluate_depth
from prgbd.cli.tasks.depth import make_sensor
from prgbd.cli.tasks.reporting import report
from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import Trajectory
from prgbd.evaluation.trajectory import FEWEST_POSES, evaluate_trajectory
from prgbd.io.text_tables import text_lines
from prgbd.io.time_base import REACH, no_meeting
from prgbd.io.trajectory_files import at_frames, read_kitti, read_tum
from prgbd.loop.summary import write_summary, write_truth

log = logging.getLogger("prgbd")


def run(job: Job) -> None:
    """Evaluate what the configuration names and write the report."""
    sequences = [*job.parts.sequences, *job.parts.test_sequences]
    job.store.step("truth", lambda: write_truth(job.store, sequences))
    pose = job.store.step("loops/00/pose", lambda: _evaluate_trajectory(job, sequences))
    if job.parts.estimator is not None:
        summary = evaluate_depth(job, [make_sensor(job, sequence) for sequence in sequences])
        if summary["loops"][0]["depth"] is None and not pose:
            raise DataError(
                f"The data '{job.parts.ids['data']}' has no true depth to evaluate against; choose data that has, or "
                "task=depth to write depth maps."
            )
        loops = [{**summary["loops"][0], "pose": pose}]
    else:
        loops = [{"loop": 0, "name": "trajectory", "pose": pose, "depth": None, "training": None}]
    report(job, write_summary(job.store, job.identity, sequences, loops))


def _evaluate_trajectory(job: Job, sequences: list[Sequence]) -> dict[str, Any]:
    assert isinstance(job.options.task, EvaluateTask)
    path = job.options.task.trajectory
    if path is None:
        return {}
    if len(sequences) != 1:
        names = ", ".join(sequence.name for sequence in sequences)
        raise ConfigError(f"task.trajectory belongs to one recording, not to {names}; name it in data.sequences=[...].")
    return {sequences[0].name: trajectory_figures(path, sequences[0], job.options.evaluation.alignment)}


def trajectory_figures(path: Path, sequence: Sequence, alignment: str) -> dict[str, Any]:
    """Return the figures of a trajectory file against the truth of a recording.

    Raises:
        DataError: If there is no truth, or too few of the poses belong to an image with a true pose.
    """
    if sequence.poses is None:
        raise DataError(
            f"The recording '{sequence.name}' has no true poses to compare {path} with; drop task.trajectory."
        )
    trajectory, doubts = read_trajectory(path, sequence)
    figures = evaluate_trajectory(trajectory, len(sequence), sequence.poses, sequence.timestamps, alignment=alignment)
    if figures["pairs"] == 0:
        raise DataError(f"{path} cannot be compared with the recording '{sequence.name}'. {figures['reason']}")
    return {**figures, "keyframes": None, "points": None, "fps": None, "lost_frames": None, "doubts": doubts}


def read_trajectory(path: Path, sequence: Sequence) -> tuple[Trajectory, list[str]]:
    """Read a trajectory of a recording in TUM format (8 numbers a line) or KITTI format (12, one line per frame).

    Returns:
        The trajectory, and what had to be assumed about its times.

    Raises:
        DataError: If the file is missing, of neither format, or its times are not the recording's.
    """
    lines = text_lines(path, "task.trajectory")
    columns = len(lines[0][1]) if lines else 8
    if columns == 12:
        return read_kitti(path, sequence.timestamps), []
    trajectory = read_tum(path)
    found, note = at_frames(trajectory, sequence.timestamps, f"the trajectory {path}")
    if note:
        log.warning("%s", note)
    elif len(found) < min(FEWEST_POSES, len(trajectory)):
        near = f"Only {len(found)} of the {len(trajectory)} poses lie within {REACH:g} s of an image"
        raise DataError(f"{near}. {no_meeting(trajectory.timestamp, sequence.timestamps, f'the trajectory {path}')}")
    return found, [note] if note else []
