"""The picture of the SLAM benchmark: trajectories from above and ahead, error and time over the frames."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from slam_trajectories import Aligned

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

COLOURS = ("tab:red", "tab:blue", "tab:green", "tab:orange", "tab:purple")


def draw(
    path: Path,
    truth: NDArray[np.float64],
    named: dict[str, Aligned],
    keyframes: NDArray[np.int64],
    lost: list[int],
    frames: NDArray[np.int64],
    seconds: NDArray[np.float64],
    title: str,
) -> None:
    """Draw trajectories, errors and time per frame.

    Args:
        path: PNG to write.
        truth: (F, 3) true positions, not finite where unknown.
        named: Name -> aligned trajectory; the first one is ours.
        keyframes: (K,) frames that are keyframes of ours.
        lost: Frames without a pose of ours.
        frames: (N,) frames that were used.
        seconds: (N,) wall time of each.
        title: Of the picture.
    """
    figure, axes = plt.subplots(2, 2, figsize=(13, 10))
    _trajectories(axes[0, 0], truth, named, keyframes, (0, 2))
    _trajectories(axes[0, 1], truth, named, keyframes, (0, 1))
    for colour, (name, aligned) in zip(COLOURS, named.items(), strict=False):
        axes[1, 0].plot(aligned.frames, aligned.errors, color=colour, lw=1, label=f"{name}, RMSE {aligned.rmse:.3f} m")
    axes[1, 0].set(xlabel="frame", ylabel="position error [m]")
    axes[1, 0].legend()
    axes[1, 1].plot(frames, 1000 * seconds, ".", ms=2, color="0.4")
    axes[1, 1].set(xlabel="frame", ylabel="time of track [ms]", ylim=(0, 1100 * float(np.percentile(seconds, 99))))
    half = 0.5 * float(frames[1] - frames[0])
    for axis in (axes[1, 0], axes[1, 1]):
        for i in lost:
            axis.axvspan(i - half, i + half, color="tab:red", alpha=0.15, lw=0)
    figure.suptitle(title)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def _trajectories(
    axis: Axes,
    truth: NDArray[np.float64],
    named: dict[str, Aligned],
    keyframes: NDArray[np.int64],
    plane: tuple[int, int],
) -> None:
    u, v = plane
    axis.plot(truth[:, u], truth[:, v], "k-", lw=2, alpha=0.5, label="truth")
    for number, (colour, (name, aligned)) in enumerate(zip(COLOURS, named.items(), strict=False)):
        positions = aligned.estimate.copy()
        gaps = np.flatnonzero(np.diff(aligned.frames) > np.median(np.diff(aligned.frames)))
        axis.plot(*np.insert(positions[:, [u, v]], gaps + 1, np.nan, axis=0).T, color=colour, lw=1, label=name)
        if number == 0:
            chosen = positions[np.isin(aligned.frames, keyframes)]
            axis.plot(chosen[:, u], chosen[:, v], ".", ms=3, color=colour, label=f"{len(chosen)} keyframes")
    axis.set_aspect("equal", "datalim")
    axis.set(xlabel=f"{'xyz'[u]} [m]", ylabel=f"{'xyz'[v]} [m]")
    axis.legend()
