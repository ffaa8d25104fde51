"""``task=evaluate``: a network's depth, and / or a trajectory file, against the truth of recordings."""

from __future__ import annotations

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
from prgbd.evaluation.trajectory import evaluate_trajectory
from prgbd.io.trajectory_files import read_kitti, read_tum
from prgbd.loop.summary import write_summary, write_truth


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
    sequence = sequences[0]
    trajectory = read_trajectory(path, sequence)
    alignment = job.options.evaluation.alignment
    figures = evaluate_trajectory(trajectory, len(sequence), sequence.poses, sequence.timestamps, alignment=alignment)
    return {sequence.name: {**figures, "keyframes": None, "points": None, "fps": None, "lost_frames": None}}


def read_trajectory(path: Path, sequence: Sequence) -> Trajectory:
    """Read a trajectory of a recording in TUM format (8 numbers a line) or KITTI format (12, one line per frame).

    Raises:
        DataError: If the file is missing or of neither format.
    """
    if not path.is_file():
        raise DataError(f"There is no trajectory file {path}; check task.trajectory.")
    first = next((line for line in path.read_text(errors="replace").splitlines() if line[:1] not in ("#", "")), "")
    if len(first.split()) == 12:
        return read_kitti(path, sequence.timestamps)
    return read_tum(path, sequence.timestamps)
