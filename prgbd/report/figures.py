"""The figures of a report: each function returns a matplotlib ``Figure``, of which ``drawing`` makes files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import MapPoints, SlamResult
from prgbd.report.drawing import INK, MOST_POINTS, MUTED, STYLE, broken, legend_above, loop_colours, new_figure
from prgbd.report.words import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHTS = (1.8, 4.0)  # inches, of the axes of trajectories seen from above
STRAY = 0.02  # share of a map's points on each side that a view from above need not show
FAR = 50  # times the extent of the paths that points may lie away to be shown
STATE_COLOURS = {
    "ok": "#3aa675",
    "interpolated": "#e0a73c",
    "lost": "#d1495b",
    "not_initialized": "#aab0bb",
    "collected": "#7aa6d8",
}


@dataclass(frozen=True)
class Path3D:
    """A path to draw.

    Attributes:
        label: Name in the legend.
        frames: (N,) frame numbers, ascending; a gap in them is a gap in the line.
        xyz: (N, 3) metres in the common frame.
        colour: Any matplotlib colour; ``INK`` marks the truth.
        map: Points in the common frame that were mapped on the way, or None.
    """

    label: str
    frames: NDArray[np.int64]
    xyz: NDArray[np.float64]
    colour: str = INK
    map: MapPoints | None = None


@dataclass(frozen=True)
class Estimate:
    """What SLAM made of a recording.

    Attributes:
        label: Name of the loop or the run.
        colour: Of its lines.
        result: Trajectory and map.
        ate: ATE RMSE in metres, None where it is not known.
    """

    label: str
    colour: str
    result: SlamResult
    ate: float | None = None

    @property
    def title(self) -> str:
        """The label with the error."""
        return self.label if self.ate is None else f"{self.label}, {number(self.ate)} m"


def horizontal_axes(wTc: NDArray[np.float64]) -> tuple[int, int]:
    """Return the world axes (right, up) of a view from above that is not mirrored.

    The camera's y axis points down, so the world axis that is most along its mean is the vertical one.
    """
    down = wTc[:, :3, 1].mean(axis=0) if len(wTc) else np.array([0.0, 1.0, 0.0])
    axis = int(np.argmax(np.abs(down)))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    return (second, first) if down[axis] > 0 else (first, second)


def extent(paths: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner of the box that paths and map fill.

    A few points of every map are far from where they belong and would make the rest a speck, so the outermost
    ``STRAY`` of the points on each side do not count, nor do those ``FAR`` times the size of the paths away.

    Args:
        paths: (N, D) positions of all paths.
        points: (P, D) points of all maps.
    """
    paths = paths if len(paths) else np.zeros((1, paths.shape[1]))
    low, high = paths.min(axis=0), paths.max(axis=0)
    reach = FAR * float((high - low).max())
    near = points[np.isfinite(points).all(axis=1)]
    near = near[(np.abs(near - (low + high) / 2) < reach).all(axis=1)]
    if len(near):
        inner, outer = np.quantile(near, (STRAY, 1 - STRAY), axis=0)
        low, high = np.minimum(low, inner), np.maximum(high, outer)
    return low, high


@matplotlib.rc_context(STYLE)
def trajectory_figure(
    paths: Sequence[Path3D], axes: tuple[int, int], points: NDArray[np.float64] | None = None, unit: str = "m"
) -> Figure:
    """Draw paths from above over the map.

    Args:
        paths: The paths; the truth first.
        axes: World axes to the right and up, see ``horizontal_axes``.
        points: (P, 3) map points to draw faintly below, or None.
        unit: Unit of the axes.
    """
    flat = (np.zeros((0, 3)) if points is None else points)[:, list(axes)]
    low, high = extent(np.concatenate([np.zeros((0, 3)), *(p.xyz for p in paths)])[:, list(axes)], flat)
    margin = 0.08 * max(float((high - low).max()), 1e-6)
    middle, size = (low + high) / 2, high - low + 2 * margin
    inches = np.array([4.5, float(np.clip(4.5 * size[1] / size[0], *HEIGHTS))])  # about the size of the axes
    half = 0.5 * (size / inches).max() * inches
    figure, ax = new_figure(inches[1] + 1.0)
    flat = flat[(np.abs(flat - middle) < half).all(axis=1)]
    flat = flat[:: max(1, len(flat) // 20000)]
    if len(flat):
        ax.plot(flat[:, 0], flat[:, 1], ".", color="#8a93a3", ms=1.8, alpha=0.5, mew=0, rasterized=True)
    for path in paths:
        (line,) = broken(path.frames, path.xyz[:, list(axes)])
        truth = path.colour == INK
        ax.plot(
            line[:, 0], line[:, 1], color=path.colour, label=path.label, lw=1.2 if truth else 1.8,
            ls=(0, (4, 2)) if truth else "-",
        )  # fmt: skip
    if paths and len(paths[0].xyz):
        ax.plot(*paths[0].xyz[0, list(axes)], "o", mfc="none", mec=INK, ms=7, mew=1.3, label="start")
    ax.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
    ax.set_aspect("equal")
    ax.set_xlabel(f"{'xyz'[axes[0]]} ({unit})")
    ax.set_ylabel(f"{'xyz'[axes[1]]} ({unit})")
    legend_above(figure, ax)
    return figure


@matplotlib.rc_context(STYLE)
def error_figure(series: Sequence[tuple[str, str, NDArray[np.int64], NDArray[np.float64]]], unit: str = "m") -> Figure:
    """Draw position errors over frames; each series is ``(label, colour, frames, errors)``."""
    figure, ax = new_figure(3.0)
    for label, colour, frames, errors in series:
        x, y = broken(frames, frames, errors)
        ax.plot(x, y, color=colour, label=label)
    ax.set_ylim(bottom=0)
    ax.set_xlabel("frame")
    ax.set_ylabel(f"position error ({unit})")
    legend_above(figure, ax)
    return figure


@matplotlib.rc_context(STYLE)
def timeline_figure(estimates: Sequence[Estimate]) -> Figure:
    """Draw state, keyframes, loop closures and relocalisations by frame as strips, and the inlier matches below."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch

    heights = [0.28 * len(estimates) + 0.15, 1.7]
    figure, (top, bottom) = new_figure(sum(heights) + 1.0, 2, 1, sharex=True, height_ratios=heights)
    seen: dict[str, str] = {}
    for row, estimate in enumerate(estimates):
        states, keyframes = list(estimate.result.states), estimate.result.keyframes.frame_index
        colours = [STATE_COLOURS.get(state, MUTED) for state in states]
        seen |= dict(zip(states, colours, strict=True))
        strip = np.array([[to_rgb(c) for c in colours]]) if colours else np.ones((1, 1, 3))
        box = (-0.5, max(len(colours), 1) - 0.5, row + 0.36, row - 0.36)
        top.imshow(strip, aspect="auto", extent=box, interpolation="nearest")
        thin = min(0.9, 90 / max(len(keyframes), 1))  # many ticks must not hide the state
        top.vlines(keyframes, row + 0.1, row + 0.36, color="white", lw=thin, alpha=0.9)
        again = [i for i in range(1, len(states)) if states[i] == "ok" and states[i - 1] == "lost"]
        for marked, sign in ((_closures(estimate.result), "^"), (again, "o")):
            if len(marked):  # an empty line has no extent, which confuses the layout
                top.plot(marked, [row - 0.2] * len(marked), sign, color=INK, mec="white", mew=0.6, ms=6.5)
        frames = np.arange(len(estimate.result.inliers))
        x, y = broken(frames, frames, estimate.result.inliers)
        bottom.plot(x, y, color=estimate.colour, lw=1.3, label=estimate.label)
    top.set_ylim(len(estimates) - 0.5, -0.5)
    top.set_yticks(range(len(estimates)), [estimate.label for estimate in estimates])
    top.grid(False)
    top.spines[:].set_visible(False)
    bottom.set_ylim(bottom=0)
    bottom.set(xlabel="frame", ylabel="inliers")
    handles = [Patch(color=c, label=s.replace("_", " ")) for s, c in sorted(seen.items())]
    figure.legend(handles=handles, loc="outside upper left", ncols=4, handlelength=0.9)
    return figure


def _closures(result: SlamResult) -> list[int]:
    """Return the frames at which a loop was closed or two maps were joined."""
    notes = result.stats.get("loops") if isinstance(result.stats, dict) else None
    return [int(note["frame"]) for note in notes or [] if isinstance(note, dict) and "frame" in note]


def loss_terms(loops: Sequence[tuple[str, dict[str, NDArray[np.float64]]]]) -> list[str]:
    """Return the names of the loss terms that have any figure, the total first."""
    names = dict.fromkeys(n for _, c in loops for n in c if n not in ("step", "epoch") and np.isfinite(c[n]).any())
    return sorted(names, key=lambda n: n != "total")


@matplotlib.rc_context(STYLE)
def loss_figure(loops: Sequence[tuple[str, dict[str, NDArray[np.float64]]]], term: str) -> Figure:
    """Draw one loss term over the steps of all loops, one after another.

    Args:
        loops: Name and columns of ``losses.csv`` of each loop.
        term: The column to draw.
    """
    figure, ax = new_figure(2.4, width=3.9)
    starts = np.concatenate([[0], np.cumsum([max((len(v) for v in c.values()), default=0) for _, c in loops])])
    for (label, losses), start, colour in zip(loops, starts, loop_colours(len(loops)), strict=False):
        if term in losses and len(losses[term]):
            _draw_loss(ax, start + np.arange(len(losses[term])), losses[term], colour, label)
    for start in starts[1:-1]:
        ax.axvline(start - 0.5, color=MUTED, lw=0.8, ls=":")
    ax.set_title(term.replace("_", " "), pad=5)
    ax.margins(x=0.02)
    ax.locator_params(axis="y", nbins=4)
    ax.locator_params(axis="x", integer=True)
    ax.set_xlabel("training step")
    if len(loops) > 1 and term == "total":
        ax.legend()
    return figure


def _draw_loss(ax: Axes, steps: NDArray[Any], values: NDArray[np.float64], colour: str, label: str) -> None:
    window = max(1, len(values) // 25)
    thin = max(1, len(values) // MOST_POINTS)
    if window > 1:
        ax.plot(steps[::thin], values[::thin], color=colour, lw=0.7, alpha=0.3)
        kernel = np.ones(window) / window
        values, steps = np.convolve(values, kernel, "valid"), steps[window // 2 :][: len(values) - window + 1]
    ax.plot(steps[::thin], values[::thin], color=colour, lw=1.7, label=label, marker="o" if len(values) == 1 else "")
