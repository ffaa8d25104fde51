"""Trajectories of a run as the KITTI odometry benchmark takes them.

The benchmark's test sequences 11-21 have no published poses. A submission is one file per sequence with a line of 12
numbers per frame: the first three rows of ``c0Tc``, which maps the coordinates of camera 0 (the left gray one) at that
frame to those of camera 0 at the first frame (devkit's readme).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError, PrgbdError
from prgbd.core.registry import REGISTRY
from prgbd.core.types import Trajectory
from prgbd.io.disk import writing
from prgbd.io.trajectory_files import fill_poses, write_kitti
from prgbd.loop.store import read_config
from prgbd.report.reading import Run, judged_sequences, open_run

DATA = "kitti_odometry"
FROM_TRUTH = "truth"


@dataclass(frozen=True)
class Submitted:
    """One file of a submission.

    Attributes:
        path: The file.
        frames: Frames of the sequence, each with a line.
        tracked: Frames of these with a pose of their own; the others' are interpolated or held.
        scale: Factor on the estimated translations.
    """

    path: Path
    frames: int
    tracked: int
    scale: float


def write_leaderboard(folder: Path, out: Path | None = None, scale: str = "1") -> list[Submitted]:
    """Write the trajectories that a run keeps, of its test recordings or, without any, of all its recordings.

    Args:
        folder: The run folder, of ``task=slam`` or ``self_improve``.
        out: Where the files go; None for ``leaderboard/`` in the run folder.
        scale: Factor on the translations, or ``truth``: the median of those that the Sim3 alignment found on recordings
            of the run with true poses. Trajectories in mono or from a network's depth have no metres of their own.

    Raises:
        ConfigError: If the run is of other data, covers a part of the frames only, or the scale cannot be had.
        DataError: If the folder is no run, or lacks a trajectory.
    """
    run = open_run(folder)
    if run.summary.get("data") != DATA:
        raise ConfigError(f"{folder} is a run on {run.summary.get('data')}; the leaderboard is one of data={DATA}.")
    if not run.kept_loops:
        raise DataError(f"{folder} has not finished a loop; go on with it: python -m prgbd resume={folder}")
    factor = _scale(run, scale)
    out = out or run.path / "leaderboard"
    with writing(out / "00.txt"):
        out.mkdir(parents=True, exist_ok=True)
    return [_write(run, name, out, factor) for name in judged_sequences(run.summary) or run.sequences]


def _write(run: Run, name: str, out: Path, factor: float) -> Submitted:
    result = run.result(run.kept_loops[-1], name)
    if result is None:
        raise DataError(f"{run.path} has no trajectory of sequence {name}; run task=slam or the loop on it.")
    frames, c0Tc = _sequence(run, name)
    if result.frames != frames:
        raise ConfigError(
            f"The run has {result.frames} of the {frames} frames of sequence {name}, and a submission needs them all; "
            "run it without data.start, data.stop and data.step."
        )
    poses = of_camera_0(fill_poses(result.trajectory, frames), c0Tc, factor)
    path = out / f"{name}.txt"
    write_kitti(Trajectory(np.arange(frames), np.arange(frames, dtype=np.float64), poses), path)
    return Submitted(path, frames, len(result.trajectory), factor)


def of_camera_0(wTc: NDArray[np.float64], c0Tc: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    """Return the poses of camera 0 relative to its first one.

    Args:
        wTc: (N, 4, 4) poses of the camera that was used.
        c0Tc: (4, 4) metres; that camera to camera 0, rigidly mounted beside it.
        factor: On the translations of ``wTc``.
    """
    relative = np.linalg.inv(wTc[0]) @ wTc
    relative[:, :3, 3] *= factor
    return np.asarray(c0Tc @ relative @ np.linalg.inv(c0Tc))


def _sequence(run: Run, name: str) -> tuple[int, NDArray[np.float64]]:
    """The number of frames of a whole sequence, and ``c0Tc`` of the camera that the run used."""
    try:
        config: Any = read_config(run.path)
        data = config["data"]
        root = Path(str((config.get("run") or {}).get("started_in") or "."), data["root"])
    except (PrgbdError, KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{run.path / 'config.yaml'} does not say where the recordings lie; run it again.") from error
    options = {"root": root, "sequence": name, "camera": data.get("camera", "auto")}
    sequence = REGISTRY.make("data", DATA, checks=False, **options)
    return len(sequence), sequence.c0Tc


def _scale(run: Run, scale: str) -> float:
    if scale == FROM_TRUTH:
        poses = (run.kept_loops[-1].get("pose") or {}).values()
        known = [float(pose["scale"]) for pose in poses if pose.get("scale")]
        if not known:
            raise ConfigError(
                f"No recording of {run.path} has true poses to take the scale from; give --scale FACTOR, or run one of "
                "the sequences 00-10 with the same network."
            )
        return float(np.median(known))
    try:
        factor = float(scale)
    except ValueError:
        factor = 0.0
    if not (np.isfinite(factor) and factor > 0):
        raise ConfigError(f"--scale is '{scale}'; it must be a positive number, or {FROM_TRUTH}.")
    return factor


def leaderboard(run: Path, folder: Path | None, scale: str) -> int:
    """Write the files and print a line of each; see ``write_leaderboard``.

    Returns:
        The exit code, 0.
    """
    for file in write_leaderboard(run, folder, scale):
        filled = file.frames - file.tracked
        note = f", {filled} of them interpolated or held, for they have no pose" if filled else ""
        print(f"{file.path}: {file.frames} poses, scale {file.scale:.4g}{note}")
    return 0
