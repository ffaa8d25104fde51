"""Trajectories of the SLAM benchmark: files of other systems, and errors against the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from evo.core.metrics import APE, PoseRelation
from evo.core.trajectory import PosePath3D
from evo.tools import file_interface
from evo.tools.file_interface import FileInterfaceException
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.core.types import Trajectory

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Aligned:
    """A trajectory laid over the truth.

    Attributes:
        frames: (N,) positions in the sequence.
        truth: (N, 3) true positions, metres.
        estimate: (N, 3) aligned positions, metres.
        errors: (N,) distances, metres.
        scale: Factor on the estimate.
    """

    frames: NDArray[np.int64]
    truth: FloatArray
    estimate: FloatArray
    errors: FloatArray
    scale: float

    @property
    def rmse(self) -> float:
        """Absolute trajectory error, root mean square, metres."""
        return float(np.sqrt(np.mean(self.errors**2)))


def align(trajectory: Trajectory, truth: FloatArray, *, scale: bool, only: NDArray[np.int64] | None = None) -> Aligned:
    """Align a trajectory with the truth (evo) and measure it.

    Args:
        trajectory: Estimated poses.
        truth: (F, 4, 4) true camera-to-world poses of all frames; not finite where unknown.
        scale: Whether scale is free (Sim3) or not (SE3).
        only: Frames to look at; None for all that both know.
    """
    known = np.isfinite(truth[trajectory.frame_index]).all(axis=(1, 2))
    if only is not None:
        known &= np.isin(trajectory.frame_index, only)
    frames = trajectory.frame_index[known]
    reference = PosePath3D(poses_se3=list(truth[frames]))
    estimate = PosePath3D(poses_se3=list(trajectory.wTc[known]))
    _, _, factor = estimate.align(reference, correct_scale=scale)
    metric = APE(PoseRelation.translation_part)
    metric.process_data((reference, estimate))
    return Aligned(frames, reference.positions_xyz, estimate.positions_xyz, np.asarray(metric.error), float(factor))


def read_tum(path: Path, timestamps: FloatArray, fps: float | None) -> Trajectory:
    """Read another system's trajectory.

    Args:
        path: File in TUM format.
        timestamps: (F,) seconds of our frames.
        fps: Takes ``round(time * fps)`` as the frame; None takes the frame whose time is nearest.

    Raises:
        DataError: If the file cannot be read or no pose belongs to a frame.
    """
    try:
        other = file_interface.read_tum_trajectory_file(path)
    except (FileInterfaceException, OSError) as error:
        raise DataError(f"Cannot read the trajectory '{path}' ({error}); give a file in TUM format.") from None
    if fps is not None:
        frames = np.rint(other.timestamps * fps).astype(np.int64)
    else:
        frames = np.abs(other.timestamps[:, None] - timestamps[None]).argmin(axis=1)
    inside = (frames >= 0) & (frames < len(timestamps))
    if not inside.any():
        raise DataError(f"No pose of '{path}' belongs to a frame of the sequence; set --compare-fps.")
    return Trajectory(frames[inside], other.timestamps[inside], np.stack(other.poses_se3)[inside])
