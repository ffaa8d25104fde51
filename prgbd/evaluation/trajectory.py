"""How far a trajectory is from the truth: ATE and RPE through evo, and the KITTI odometry benchmark's relative errors.

Poses belong to each other by their frame number. Every figure comes with its alignment and with how many poses it
rests on, because an error without them says little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.alignment import Alignment, fit_alignment
from prgbd.core.errors import DataError
from prgbd.core.types import Trajectory

KITTI_LENGTHS = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
KITTI_STEP = 10
FEWEST_POSES = 3


@dataclass(frozen=True)
class AbsoluteError:
    """The absolute trajectory error (ATE), in metres after alignment.

    Attributes:
        rmse: Root of the mean squared distance.
        mean: Mean distance.
        median: Median distance.
        max: Largest distance.
        alignment: ``sim3``, ``se3`` or ``none``.
        scale: Factor that the alignment put on the estimate.
        pairs: Number of compared poses.
        frame_index: (pairs,) frames that were compared.
        errors: (pairs,) distance of each.
        transform: The alignment itself.
    """

    rmse: float
    mean: float
    median: float
    max: float
    alignment: str
    scale: float
    pairs: int
    frame_index: NDArray[np.int64]
    errors: NDArray[np.float64]
    transform: Alignment


@dataclass(frozen=True)
class KittiError:
    """The KITTI odometry benchmark's relative errors, each the mean over ``segments``.

    Attributes:
        translation_percent: Translation error in percent of the segment's length.
        rotation_deg_per_m: Rotation error in degrees per metre.
        segments: Number of segments; 0 where the path is too short, and the errors are then NaN.
        skipped: Segments left out because their first or last frame has no pose.
    """

    translation_percent: float
    rotation_deg_per_m: float
    segments: int
    skipped: int


def absolute_error(trajectory: Trajectory, truth_wTc: NDArray[np.float64], alignment: str = "sim3") -> AbsoluteError:
    """Compute the ATE over all frames that have both an estimated and a true pose.

    Args:
        trajectory: The estimate.
        truth_wTc: (N, 4, 4) true poses by frame, NaN where unknown.
        alignment: ``sim3``, ``se3`` or ``none``.

    Raises:
        DataError: If fewer than 3 poses can be compared, or the true camera stands still.
        ConfigError: If the alignment is unknown.
    """
    from evo.core.metrics import APE
    from evo.core.trajectory import PosePath3D

    rows, estimate, truth = _pair(trajectory, truth_wTc)
    if len(rows) < FEWEST_POSES:
        raise DataError(f"Only {len(rows)} of the poses have a true pose to compare with; {FEWEST_POSES} are needed.")
    if alignment != "none" and np.ptp(truth[:, :3, 3], axis=0).max() < 1e-9:
        raise DataError("The true camera does not move, so no alignment is possible.")
    transform = fit_alignment(estimate[:, :3, 3], truth[:, :3, 3], alignment)
    aligned = transform.poses(estimate)
    metric = APE()
    metric.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(aligned))))
    statistics = metric.get_all_statistics()
    return AbsoluteError(
        rmse=float(statistics["rmse"]),
        mean=float(statistics["mean"]),
        median=float(statistics["median"]),
        max=float(statistics["max"]),
        alignment=alignment,
        scale=transform.scale,
        pairs=len(rows),
        frame_index=trajectory.frame_index[rows],
        errors=np.asarray(metric.error),
        transform=transform,
    )


def relative_error(
    trajectory: Trajectory, truth_wTc: NDArray[np.float64], scale: float = 1.0, delta: int = 1
) -> tuple[float, float, int]:
    """Compute the relative pose error (RPE) between frames ``delta`` apart; pairs that span a gap are left out.

    Args:
        trajectory: The estimate.
        truth_wTc: (N, 4, 4) true poses by frame, NaN where unknown.
        scale: Factor on the estimate's translations, from a Sim3 alignment.
        delta: Frames between the poses of a pair.

    Returns:
        ``(translation, rotation, pairs)``: root mean squares in metres and degrees (NaN without pairs) and how many.
    """
    from evo.core import lie_algebra as lie
    from evo.core.metrics import RPE

    rows, estimate, truth = _pair(trajectory, truth_wTc)
    estimate = estimate.copy()
    estimate[:, :3, 3] *= scale
    row_of_frame = {int(f): i for i, f in enumerate(trajectory.frame_index[rows])}
    pairs = [(i, row_of_frame[f + delta]) for f, i in row_of_frame.items() if f + delta in row_of_frame]
    if not pairs:
        return float("nan"), float("nan"), 0
    errors = [RPE.rpe_base(truth[i], truth[j], estimate[i], estimate[j]) for i, j in pairs]
    translation = np.array([np.linalg.norm(e[:3, 3]) for e in errors])
    rotation = np.array([lie.so3_log_angle(e[:3, :3], degrees=True) for e in errors])
    return float(np.sqrt(np.mean(translation**2))), float(np.sqrt(np.mean(rotation**2))), len(pairs)


def kitti_error(trajectory: Trajectory, truth_wTc: NDArray[np.float64], scale: float = 1.0) -> KittiError:
    """Compute the relative errors by the KITTI odometry benchmark's rule (``evaluate_odometry`` of its devkit).

    Segments start at every 10th frame, are 100, 200, ... 800 m long along the true path, and end at the first frame
    beyond that length. The errors are means over all segments of all lengths.

    Args:
        trajectory: The estimate.
        truth_wTc: (N, 4, 4) true poses by frame, NaN where unknown (the path runs straight across such frames).
        scale: Factor on the estimate's translations, from a Sim3 alignment.
    """
    truth_wTc = np.asarray(truth_wTc, np.float64)
    known = np.flatnonzero(np.isfinite(truth_wTc).all(axis=(1, 2)))
    estimate = np.full_like(truth_wTc, np.nan)
    estimate[trajectory.frame_index] = trajectory.wTc
    estimate[:, :3, 3] *= scale
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth_wTc[known, :3, 3], axis=0), axis=1))])
    every = np.flatnonzero(known % KITTI_STEP == 0)
    starts, lengths = np.repeat(every, len(KITTI_LENGTHS)), np.tile(KITTI_LENGTHS, len(every))
    ends = np.searchsorted(distance, distance[starts] + lengths, side="right") if len(starts) else starts
    reached = ends < len(known)
    first, last, lengths = known[starts[reached]], known[ends[reached]], lengths[reached]
    tracked = np.isfinite(estimate[first]).all(axis=(1, 2)) & np.isfinite(estimate[last]).all(axis=(1, 2))
    first, last, lengths = first[tracked], last[tracked], lengths[tracked]
    skipped = int(np.count_nonzero(~tracked))
    if len(first) == 0:
        return KittiError(float("nan"), float("nan"), 0, skipped)
    true_step = np.linalg.inv(truth_wTc[first]) @ truth_wTc[last]
    step = np.linalg.inv(estimate[first]) @ estimate[last]
    error = np.linalg.inv(step) @ true_step
    angle = np.arccos(np.clip(0.5 * (np.trace(error[:, :3, :3], axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    return KittiError(
        translation_percent=float(np.mean(np.linalg.norm(error[:, :3, 3], axis=1) / lengths) * 100.0),
        rotation_deg_per_m=float(np.degrees(np.mean(angle / lengths))),
        segments=len(first),
        skipped=skipped,
    )


def evaluate_trajectory(
    result_trajectory: Trajectory,
    frames: int,
    truth_wTc: NDArray[np.float64] | None,
    timestamps: NDArray[np.float64] | None = None,
    alignment: str = "sim3",
    delta: int = 1,
) -> dict[str, Any]:
    """Compare a trajectory with the truth by frame number and return plain numbers for ``summary.json``.

    Args:
        result_trajectory: The estimate.
        frames: Number of frames that SLAM was given.
        truth_wTc: (frames, 4, 4) true poses, NaN where unknown, or None without ground truth.
        timestamps: (frames,) seconds, for ``duration_s``; None leaves it out.
        alignment: ``sim3`` (monocular and pseudo RGB-D), ``se3`` (metric) or ``none``.
        delta: Frames between the poses of a pair of the RPE.

    Returns:
        The keys of docs/summary-schema.md. A figure that does not apply is None and ``reason`` says why.

    Raises:
        DataError: If the truth does not have one pose per frame, or the trajectory has a frame beyond the last.
        ConfigError: If the alignment is unknown.
    """
    if len(result_trajectory) and int(result_trajectory.frame_index[-1]) >= frames:
        raise DataError(
            f"The trajectory has a pose for frame {int(result_trajectory.frame_index[-1])} of only {frames} frames."
        )
    out = _empty_evaluation(result_trajectory, frames, alignment, delta)
    if timestamps is not None and len(timestamps) > 1:
        out["duration_s"] = float(timestamps[-1] - timestamps[0])
    if truth_wTc is None:
        return out | {"reason": "There is no ground truth."}
    truth_wTc = np.asarray(truth_wTc, np.float64)
    if truth_wTc.shape != (frames, 4, 4):
        raise DataError(
            f"There are {len(truth_wTc)} true poses for {frames} frames; give one per frame, NaN if unknown."
        )
    known = truth_wTc[np.isfinite(truth_wTc).all(axis=(1, 2))]
    out["path_length_m"] = float(np.linalg.norm(np.diff(known[:, :3, 3], axis=0), axis=1).sum())
    try:
        ate = absolute_error(result_trajectory, truth_wTc, alignment)
    except DataError as error:
        return out | {"reason": str(error)}
    out |= {f"ate_{name}": getattr(ate, name) for name in ("rmse", "mean", "median", "max")}
    out |= {"pairs": ate.pairs, "scale": ate.scale}
    translation, rotation, pairs = relative_error(result_trajectory, truth_wTc, ate.scale, delta)
    if pairs:
        out |= {"rpe_translation": translation, "rpe_rotation_deg": rotation, "rpe_pairs": pairs}
    kitti = kitti_error(result_trajectory, truth_wTc, ate.scale)
    out |= {"kitti_segments": kitti.segments, "kitti_segments_skipped": kitti.skipped}
    if kitti.segments:
        out["kitti_translation_percent"] = kitti.translation_percent
        out["kitti_rotation_deg_per_m"] = kitti.rotation_deg_per_m
        # A rigid motion of the whole path does not change relative errors, so only the scale is worth a word.
        out["kitti_alignment"] = "sim3" if alignment == "sim3" else "none"
    return out


def _empty_evaluation(trajectory: Trajectory, frames: int, alignment: str, delta: int) -> dict[str, Any]:
    names = (
        "ate_rmse ate_mean ate_median ate_max scale path_length_m rpe_translation rpe_rotation_deg "
        "kitti_translation_percent kitti_rotation_deg_per_m kitti_alignment duration_s reason"
    )
    return {
        **dict.fromkeys(names.split()),
        "alignment": alignment,
        "pairs": 0,
        "tracked_frames": len(trajectory),
        "frames": frames,
        "coverage": len(trajectory) / frames if frames else 0.0,
        "rpe_pairs": 0,
        "rpe_delta_frames": delta,
        "kitti_segments": 0,
        "kitti_segments_skipped": 0,
    }


def _pair(
    trajectory: Trajectory, truth_wTc: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the trajectory's rows that have a true pose, their estimated poses and their true poses."""
    truth = np.asarray(truth_wTc, np.float64)[trajectory.frame_index]
    rows = np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)))
    return rows, trajectory.wTc[rows], truth[rows]
