"""Trajectories in files of the TUM and the KITTI format, and as evo's objects.

evo is imported where it is used, so this module is cheap to import.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.core.types import Trajectory
from prgbd.io.files import atomic_path
from prgbd.io.reading import read_text
from prgbd.io.text_tables import read_table
from prgbd.io.time_base import REACH, common_clock

if TYPE_CHECKING:
    from evo.core.trajectory import PoseTrajectory3D

log = logging.getLogger("prgbd")

QUATERNION_ERROR = 0.05  # of its length, as files round
MATRIX_ERROR = 0.05  # of the length of a rotation's axes
FARTHEST = 1e9  # metres from the origin; the farthest coordinates on Earth's maps are below 1e7
FEWEST_DISTINCT_TIMES = 2  # poses of one time, on average, that mean rounded times


def to_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    """Return the trajectory as evo's ``PoseTrajectory3D``.

    Raises:
        DataError: If the trajectory has no poses, which evo cannot hold.
    """
    from evo.core.trajectory import PoseTrajectory3D

    if len(trajectory) == 0:
        raise DataError("The trajectory has no poses, so there is nothing to compare; check that tracking initialised.")
    return PoseTrajectory3D(poses_se3=list(trajectory.wTc), timestamps=trajectory.timestamp)


def write_tum(trajectory: Trajectory, path: Path | str) -> None:
    """Write ``timestamp tx ty tz qx qy qz qw`` lines (seconds, metres, camera-to-world), one per pose."""
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        file.write("# timestamp tx ty tz qx qy qz qw\n")
        if len(trajectory):
            from evo.tools.file_interface import write_tum_trajectory_file

            write_tum_trajectory_file(file, to_evo(trajectory))


def read_tum(
    path: Path | str, timestamps: NDArray[np.float64] | None = None, max_difference: float = REACH
) -> Trajectory:
    """Read a TUM trajectory file.

    Args:
        path: The file; lines that start with ``#`` are skipped, the first of several poses of one time is kept, and
            poses are sorted by time.
        timestamps: (F,) seconds of the frames that the poses belong to, ascending; see ``at_frames``. Without it poses
            are numbered in order.
        max_difference: Largest difference in seconds for which a pose belongs to a frame.

    Raises:
        DataError: If the file is missing or malformed, or its times and those of the frames do not meet.
    """
    rows = read_table(path, 8, "time stamp, position and quaternion", finite=True)
    if len(rows) == 0:
        if not read_text(path, "trajectory").strip():
            raise DataError(f"{path} is empty; a trajectory has lines of 8 numbers.")
        return Trajectory.empty()
    given = len(rows)
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]  # motion-capture files repeat some time stamps
    if given > FEWEST_DISTINCT_TIMES * len(rows) > 0 and given > 3:
        raise DataError(
            f"{path} has {given} poses of {len(rows)} different times; write the times with all of their "
            "digits, not as 1.305031e+09."
        )
    trajectory = Trajectory(np.arange(len(rows)), rows[:, 0], as_poses(rows, path))
    if timestamps is None:
        return trajectory
    found, note = at_frames(trajectory, timestamps, f"the trajectory {path}", max_difference)
    if note:
        log.warning("%s", note)
    return found


def as_poses(rows: NDArray[np.float64], path: Path | str) -> NDArray[np.float64]:
    """Return (N, 4, 4) poses of (N, 8) rows ``time tx ty tz qx qy qz qw``.

    Raises:
        DataError: If a quaternion is not of length 1, or a position absurdly far away.
    """
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(rows[:, 4:], axis=1)
    odd = np.flatnonzero(~(np.abs(length - 1) < QUATERNION_ERROR))
    if len(odd):
        raise DataError(
            f"{path} has a quaternion of length {length[odd[0]]:.3g} at time {rows[odd[0], 0]:.15g}, which must be 1; "
            "columns 5-8 must be qx qy qz qw."
        )
    wTc = np.tile(np.eye(4), (len(rows), 1, 1))
    wTc[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
    wTc[:, :3, 3] = rows[:, 1:4]
    _check_near(wTc, path)
    return wTc


def at_frames(
    trajectory: Trajectory, timestamps: NDArray[np.float64], what: str, max_difference: float = REACH
) -> tuple[Trajectory, str]:
    """Give each frame of a recording the pose that is nearest in time.

    Args:
        trajectory: Poses with times of their own.
        timestamps: (F,) seconds of the frames, ascending.
        what: What the trajectory is, for messages.
        max_difference: Largest difference in seconds for which a pose belongs to a frame.

    Returns:
        The poses with ``frame_index`` and ``timestamp`` of their frames, and a sentence about the clock that the times
        were taken to be of, "" where it is the frames' own.

    Raises:
        DataError: If the times do not meet and nothing explains it.
    """
    timestamps = np.asarray(timestamps, np.float64)
    clock = common_clock(trajectory.timestamp, timestamps, what)
    frames, poses = match_times(timestamps, clock.seconds(trajectory.timestamp), max_difference)
    return Trajectory(frames, timestamps[frames], trajectory.wTc[poses]), clock.note


def match_times(
    frames: NDArray[np.float64], poses: NDArray[np.float64], max_difference: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows ``(frame, pose)`` of each frame time and the pose time nearest to it, if near enough (seconds)."""
    if len(poses) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    after = np.minimum(np.searchsorted(poses, frames), len(poses) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(poses[before] - frames) <= np.abs(poses[after] - frames), before, after)
    keep = np.flatnonzero(np.abs(poses[nearest] - frames) <= max_difference)
    return keep.astype(np.int64), nearest[keep].astype(np.int64)


def write_kitti(trajectory: Trajectory, path: Path | str, frames: int | None = None) -> int:
    """Write one line of 12 numbers (the first three rows of ``wTc``) per frame.

    The format has no time stamps, so every frame needs a line. A frame without a pose gets one between its nearest
    tracked neighbours, linear in the frame number (rotation by slerp); before the first and after the last tracked
    frame the pose is held; without any pose all lines are the identity.

    Args:
        trajectory: The poses.
        path: The file.
        frames: Number of frames of the sequence; None writes one line per pose and fills nothing.

    Returns:
        How many lines were filled in rather than tracked.

    Raises:
        DataError: If a pose belongs to a frame beyond ``frames``.
    """
    poses = trajectory.wTc if frames is None else fill_poses(trajectory, frames)
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        if len(poses):
            from evo.core.trajectory import PosePath3D
            from evo.tools.file_interface import write_kitti_poses_file

            write_kitti_poses_file(file, PosePath3D(poses_se3=list(poses)))
    return len(poses) - len(trajectory)


def fill_poses(trajectory: Trajectory, frames: int) -> NDArray[np.float64]:
    """Return (frames, 4, 4) poses ``wTc``, interpolated or held where the trajectory has none (see ``write_kitti``)."""
    from scipy.spatial.transform import Rotation, Slerp

    known = np.asarray(trajectory.frame_index, np.float64)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    if len(known) == 0:
        return poses
    if known[-1] >= frames or known[0] < 0:
        raise DataError(
            f"The trajectory has a pose for frame {int(known[-1])} of {frames}; give the sequence's length."
        )
    wanted = np.clip(np.arange(frames), known[0], known[-1])
    for axis in range(3):
        poses[:, axis, 3] = np.interp(wanted, known, trajectory.wTc[:, axis, 3])
    rotations = Rotation.from_matrix(trajectory.wTc[:, :3, :3])
    poses[:, :3, :3] = (
        Slerp(known, rotations)(wanted) if len(known) > 1 else rotations[np.zeros(frames, int)]
    ).as_matrix()
    poses[trajectory.frame_index] = trajectory.wTc  # tracked poses stay as they are, to the last bit
    return poses


def read_kitti(path: Path | str, timestamps: NDArray[np.float64] | None = None) -> Trajectory:
    """Read a KITTI pose file, one line per frame; time stamps are 0, 1, 2, ... unless given, (N,) seconds.

    Raises:
        DataError: If the file is missing or malformed, or has another number of lines than ``timestamps``.
    """
    rows = read_table(path, 12, "pose of one frame", finite=True)
    if len(rows) == 0:
        raise DataError(f"{path} has no poses; a pose file has lines of 12 numbers.")
    if timestamps is not None and len(timestamps) != len(rows):
        raise DataError(
            f"{path} has {len(rows)} poses for {len(timestamps)} time stamps; use the files of one sequence, and of "
            "the same frames."
        )
    wTc = np.tile(np.eye(4), (len(rows), 1, 1))
    wTc[:, :3] = rows.reshape(-1, 3, 4)
    _check_near(wTc, path)
    size = np.linalg.svd(wTc[:, :3, :3], compute_uv=False)
    odd = np.flatnonzero((np.abs(size - 1) > MATRIX_ERROR).any(axis=1) | (np.linalg.det(wTc[:, :3, :3]) < 0))
    if len(odd):
        raise DataError(f"Pose {odd[0]} of {path} is no rigid transform; columns 1-3, 5-7 and 9-11 must be a rotation.")
    stamps = np.arange(len(rows), dtype=np.float64) if timestamps is None else np.asarray(timestamps, np.float64)
    return Trajectory(np.arange(len(rows)), stamps, wTc)


def _check_near(wTc: NDArray[np.float64], path: Path | str) -> None:
    far = np.flatnonzero((np.abs(wTc[:, :3, 3]) > FARTHEST).any(axis=1))
    if len(far):
        raise DataError(f"Pose {far[0]} of {path} lies more than {FARTHEST:g} m away; positions must be in metres.")
