"""The figures of a report. Each function returns a matplotlib ``Figure``; ``to_svg`` and ``to_png`` turn it into bytes.

Figures are made without pyplot, so nothing global is touched and no display is needed. Ink, grid and secondary text
have one colour each, which the page replaces by its own so that figures follow light and dark.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID = "#010203", "#6e7072", "#d9dadb"
LOOP_COLOURS = ("#e0783a", "#c2528b", "#7a5fd0", "#2f7fc8", "#12998b")
BASELINE_COLOURS = ("#7d8794", "#9a8032")
STATE_COLOURS = {
    "ok": "#3aa675",
    "interpolated": "#e0a73c",
    "lost": "#d1495b",
    "not_initialized": "#aab0bb",
    "collected": "#7aa6d8",
}
WIDTH = 5.2  # inches; small enough that labels stay readable on a phone
MOST_POINTS = 1500  # per line; more cannot be seen and only makes the file large

STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "axes.edgecolor": GRID,
    "axes.labelcolor": MUTED,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlecolor": INK,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "xtick.minor.size": 0,
    "ytick.minor.size": 0,
    "text.color": INK,
    "lines.linewidth": 1.7,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "legend.labelcolor": INK,
    "svg.fonttype": "none",
    "svg.hashsalt": "prgbd",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}


@dataclass(frozen=True)
class Path3D:
    """A path to draw.

    Attributes:
        label: Name in the legend.
        frames: (N,) frame numbers, ascending; a gap in them is a gap in the line.
        xyz: (N, 3) metres in the common frame.
        colour: Any matplotlib colour.
    """

    label: str
    frames: NDArray[np.int64]
    xyz: NDArray[np.float64]
    colour: str = INK


@dataclass(frozen=True)
class Timeline:
    """How tracking of one sequence went.

    Attributes:
        label: Name of the loop.
        states: State of every frame.
        inliers: (F,) inlier matches of every frame.
        keyframes: (K,) frame numbers of the keyframes.
        colour: Colour of the loop.
        closures: Frames at which a loop was closed or two maps were joined.
        found: Frames with a pose after tracking was lost.
    """

    label: str
    states: list[str]
    inliers: NDArray[np.int32]
    keyframes: NDArray[np.int64]
    colour: str
    closures: Sequence[int] = ()
    found: Sequence[int] = ()


def loop_colours(count: int) -> list[str]:
    """Return one colour per loop, from the first (warm) to the last (cool)."""
    if count <= 1:
        return [LOOP_COLOURS[3]] * count
    if count == 2:
        return [LOOP_COLOURS[0], LOOP_COLOURS[3]]
    from matplotlib.colors import LinearSegmentedColormap, to_hex

    ramp = LinearSegmentedColormap.from_list("loops", LOOP_COLOURS)
    return [to_hex(ramp(i / (count - 1))) for i in range(count)]


def new_figure(
    height: float, rows: int = 1, columns: int = 1, width: float = WIDTH, **options: Any
) -> tuple[Figure, Any]:
    """Return an empty figure, sizes in inches, and its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def to_svg(figure: Figure) -> bytes:
    """Render as SVG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def to_png(figure: Figure, dpi: int = 160) -> bytes:
    """Render as PNG on white."""
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=dpi, facecolor="white")
    return buffer.getvalue()


def inline_svg(svg: bytes, label: str, prefix: str) -> str:
    """Return an SVG as an element for HTML that follows the page's theme.

    Args:
        svg: What ``to_svg`` returned.
        label: Description for screen readers.
        prefix: Unique on the page, so that references of several figures do not meet.
    """
    from html import escape

    text = svg.decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    text = re.sub(r' id="([^"]+)"', lambda m: f' id="{prefix}{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r'(href="#|url\(#)([^")]+)', rf"\g<1>{prefix}\2", text)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px var(--sans)", text)
    for colour, name in ((INK, "ink"), (MUTED, "muted"), (GRID, "grid")):
        text = text.replace(colour, f"var(--{name})")
    text = re.sub(r' (?:width|height)="[\d.]+pt"', "", text, count=2)
    return text.replace("<svg", f'<svg role="img" aria-label="{escape(label, quote=True)}"', 1)


def broken(frames: NDArray[np.int64], *columns: NDArray[Any]) -> list[NDArray[np.float64]]:
    """Thin out columns to ``MOST_POINTS`` and put NaN where frames are missing, so that no line bridges a gap."""
    frames = np.asarray(frames)
    gaps = np.flatnonzero(np.diff(frames) > 1) + 1
    keep = np.zeros(len(frames), bool)
    keep[:: max(1, len(frames) // MOST_POINTS)] = True
    ends = np.concatenate([gaps, gaps - 1, [len(frames) - 1]]).astype(int) if len(frames) else np.zeros(0, int)
    keep[ends] = True
    # Where to insert, counted in the rows that are kept.
    breaks = np.searchsorted(np.flatnonzero(keep), gaps)
    return [np.insert(np.asarray(c, np.float64)[keep], breaks, np.nan, axis=0) for c in columns]


def horizontal_axes(wTc: NDArray[np.float64]) -> tuple[int, int]:
    """Return the world axes (right, up) of a view from above that is not mirrored.

    The camera's y axis points down, so the world axis that is most along its mean is the vertical one.
    """
    down = wTc[:, :3, 1].mean(axis=0) if len(wTc) else np.array([0.0, 1.0, 0.0])
    axis = int(np.argmax(np.abs(down)))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    return (second, first) if down[axis] > 0 else (first, second)


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
    figure, ax = new_figure(5.0)
    positions = np.concatenate([p.xyz for p in paths if len(p.xyz)] or [np.zeros((1, 3))])[:, list(axes)]
    low, high = positions.min(axis=0), positions.max(axis=0)
    margin = 0.08 * max(float((high - low).max()), 1e-6)
    if points is not None and len(points):
        flat = points[:, list(axes)]
        # The view stays near the path: a few far points would shrink it to a speck.
        near = np.all((flat > low - 8 * margin) & (flat < high + 8 * margin), axis=1)
        flat = flat[near][:: max(1, int(near.sum()) // 20000)]
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
    middle, size = (low + high) / 2, high - low + 2 * margin
    inches = np.array([4.5, 4.0])  # about the size of the axes
    half = 0.5 * (size / inches).max() * inches
    ax.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
    ax.set_aspect("equal")
    ax.set_xlabel(f"{'xyz'[axes[0]]} ({unit})")
    ax.set_ylabel(f"{'xyz'[axes[1]]} ({unit})")
    _legend_above(figure, ax)
    return figure


def _legend_above(figure: Figure, ax: Axes, columns: int = 2) -> None:
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper left", ncols=columns, handlelength=1.8)


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
    _legend_above(figure, ax)
    return figure


@matplotlib.rc_context(STYLE)
def timeline_figure(timelines: Sequence[Timeline]) -> Figure:
    """Draw the state and the keyframes of every frame as strips, and the inlier matches below."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch

    heights = [0.28 * len(timelines) + 0.15, 1.7]
    figure, (top, bottom) = new_figure(sum(heights) + 1.0, 2, 1, sharex=True, height_ratios=heights)
    seen: dict[str, str] = {}
    for row, line in enumerate(timelines):
        colours = [STATE_COLOURS.get(state, MUTED) for state in line.states]
        seen |= dict(zip(line.states, colours, strict=True))
        strip = np.array([[to_rgb(c) for c in colours]]) if colours else np.ones((1, 1, 3))
        extent = (-0.5, max(len(colours), 1) - 0.5, row + 0.36, row - 0.36)
        top.imshow(strip, aspect="auto", extent=extent, interpolation="nearest")
        thin = min(0.9, 90 / max(len(line.keyframes), 1))  # many ticks must not hide the state
        top.vlines(line.keyframes, row + 0.1, row + 0.36, color="white", lw=thin, alpha=0.9)
        for marked, sign in ((line.closures, "^"), (line.found, "o")):
            if len(marked):  # an empty line has no extent, which confuses the layout
                top.plot(marked, [row - 0.2] * len(marked), sign, color=INK, mec="white", mew=0.6, ms=6.5)
        frames = np.arange(len(line.inliers))
        x, y = broken(frames, frames, line.inliers)
        bottom.plot(x, y, color=line.colour, lw=1.3, label=line.label)
    top.set_ylim(len(timelines) - 0.5, -0.5)
    top.set_yticks(range(len(timelines)), [line.label for line in timelines])
    top.grid(False)
    top.spines[:].set_visible(False)
    top.tick_params(axis="y")
    bottom.set_ylim(bottom=0)
    bottom.set_ylabel("inliers")
    bottom.set_xlabel("frame")
    handles = [Patch(color=c, label=s.replace("_", " ")) for s, c in sorted(seen.items())]
    figure.legend(handles=handles, loc="outside upper left", ncols=4, handlelength=0.9)
    return figure


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


@matplotlib.rc_context(STYLE)
def metric_figure(title: str, series: dict[str, list[float | None]]) -> Figure:
    """Draw one figure over the loops.

    Args:
        title: What it is, with its unit.
        series: One value or None per loop, by name; several names get a legend.
    """
    figure, ax = new_figure(2.1, width=2.9)
    shades = ("#2f7fc8", "#e0783a", "#12998b", "#c2528b", "#7a5fd0", "#9a8032", "#5f6b7a", "#b04a3a")
    count, top = 1, 0.0
    for i, (label, values) in enumerate(series.items()):
        y = np.array([np.nan if v is None else v for v in values])
        ax.plot(range(len(y)), y, "o-", color=shades[i % len(shades)], ms=5.5, label=label)
        count, top = max(count, len(y)), max(top, float(np.nanmax(y, initial=0.0)))
    ax.set_title(title, pad=6)
    ax.set_xticks(range(count), [str(i) for i in range(count)])
    ax.set_xlim(-0.3, count - 0.7)
    ax.set_ylim(0, 1.12 * top or 1.0)
    ax.locator_params(axis="y", nbins=5)
    ax.set_xlabel("loop")
    if len(series) > 1:
        ax.legend(fontsize=8)
    return figure
