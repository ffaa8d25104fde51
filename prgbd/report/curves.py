"""The curves of a run: every figure over the loops, and depth errors by cap, by distance, and by loop and cap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np

from prgbd.report.depth_metrics import WITH_UNITS
from prgbd.report.drawing import STYLE, Drawing, loop_colours, new_figure
from prgbd.report.reading import Run, mean_pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_LINES = 8  # sequences in one panel
SHADES = ("#2f7fc8", "#e0783a", "#12998b", "#c2528b", "#7a5fd0", "#9a8032", "#5f6b7a", "#b04a3a")
_Lines = dict[str, list[float | None]]
_Found = list[tuple[str, dict[str, Any]]]  # label and depth figures of a loop


def loop_panels(run: Run) -> list[Drawing]:
    """Return the pose error and each depth metric over the loops, as far as a run of several loops has them."""
    if len(run.loops) < 2:
        return []
    names = run.sequences[:MOST_LINES]
    pose = {name: [mean_pose(loop, "ate_rmse", [name]) for loop in run.loops] for name in names}
    panels = {"ATE RMSE (m)": {name: values for name, values in pose.items() if _any(values)}}
    for key, title in WITH_UNITS.items():
        values = [(loop.get("depth") or {}).get(key) for loop in run.loops]
        panels[f"depth {title}" if title.startswith("RMSE") else title] = {key: values} if _any(values) else {}
    return [Drawing(f"{title} by loop", metric_figure(title, lines)) for title, lines in panels.items() if lines]


def _any(values: Sequence[float | None]) -> bool:
    return any(value is not None for value in values)


def range_curves(run: Run) -> list[Drawing]:
    """Return the curves that a run has figures for: by cap and distance for its first and last network, and by loop."""
    known = [(run.label(loop), loop["depth"]) for loop in run.loops if (loop.get("depth") or {}).get("images")]
    chosen = known if len(known) < 2 else [known[0], known[-1]]
    return [*_by_cap(chosen), *_by_distance(chosen), *_by_loop(run)]


def _differ(rows: list[dict[str, Any]] | None) -> bool:
    """Whether the caps tell anything: in a room all truth is nearer than the smallest, and all figures are one."""
    return len({tuple(row.get(metric) for metric in WITH_UNITS) for row in rows or []}) > 1


def _filled(depth: dict[str, Any]) -> int:
    """How many ranges of distance there are up to the last one that has truth."""
    return max((i + 1 for i, row in enumerate(depth.get("by_depth") or []) if row.get("pixels")), default=0)


def _by_cap(found: _Found) -> Iterator[Drawing]:
    rows = {label: depth["by_cap"] for label, depth in found if _differ(depth.get("by_cap"))}
    caps = list(dict.fromkeys(row["cap"] for own in rows.values() for row in own))
    for metric, title in WITH_UNITS.items():
        lines = {label: [_at(own, cap, metric) for cap in caps] for label, own in rows.items()}
        if any(map(_any, lines.values())):
            figure = cap_figure(f"{title} by cap", caps, lines)
            yield Drawing(f"{title} by depth cap", figure, name=f"{metric}-by-cap")


def _at(rows: list[dict[str, Any]], cap: float, metric: str) -> float | None:
    return next((row.get(metric) for row in rows if row["cap"] == cap), None)


def _by_distance(found: _Found) -> Iterator[Drawing]:
    filled = max((_filled(depth) for _, depth in found), default=0)
    bins = {label: depth["by_depth"][:filled] for label, depth in found if depth.get("by_depth") and filled > 1}
    for metric, title in WITH_UNITS.items():
        if any(_any([row.get(metric) for row in rows]) for rows in bins.values()):
            figure = bin_figure(f"{title} by distance", bins, metric)
            yield Drawing(f"{title} by true depth", figure, name=f"{metric}-by-distance")


def _by_loop(run: Run) -> Iterator[Drawing]:
    """Yield the paper's curves: metrics over the loops, one line per cap."""
    found = [(loop.get("depth") or {}).get("by_cap") or [] for loop in run.loops]
    caps = list(dict.fromkeys(row["cap"] for rows in found for row in rows if _differ(rows)))
    for metric, title in WITH_UNITS.items() if len(found) > 1 and caps else ():
        lines = {f"{cap:g} m": [_at(rows, cap, metric) for rows in found] for cap in caps}
        if any(map(_any, lines.values())):
            figure = metric_figure(f"{title} by loop and cap", lines, ordered=True)
            yield Drawing(f"{title} by loop, a line per depth cap", figure, name=f"{metric}-by-loop")


@matplotlib.rc_context(STYLE)
def metric_figure(title: str, series: _Lines, ordered: bool = False) -> Figure:
    """Draw a figure over the loops, from zero on.

    Args:
        title: What it is, with its unit.
        series: One value or None per loop, by name; several names get a legend.
        ordered: The names are steps of one quantity, and their colours are steps of one ramp.
    """
    figure, ax = new_figure(2.1, width=2.9 if len(series) < 3 else 3.6)
    count = max(map(len, series.values()), default=1)
    _draw_lines(ax, title, range(count), series, loop_colours(len(series)) if ordered else SHADES)
    top = max((value for values in series.values() for value in values if value is not None), default=0)
    ax.set(xlim=(-0.3, count - 0.7), ylim=(0, 1.12 * top or 1.0), xlabel="loop")
    ax.set_xticks(range(count), [str(i) for i in range(count)])
    if len(series) > 2:  # so many names would cover the lines
        ax.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@matplotlib.rc_context(STYLE)
def cap_figure(title: str, caps: Sequence[float], series: _Lines) -> Figure:
    """Draw a metric over the cap in metres, one line per loop."""
    figure, ax = new_figure(2.4, width=3.9)
    _draw_lines(ax, title, caps, series, loop_colours(len(series)))
    ax.set_xlabel("cap (m)")
    return figure


def _draw_lines(ax: Axes, title: str, x: Sequence[float], series: _Lines, colours: Sequence[str]) -> None:
    """Draw a line per name with its points; None leaves a gap."""
    for i, (label, values) in enumerate(series.items()):
        y = np.array([np.nan if value is None else value for value in values])
        ax.plot(x[: len(y)], y, "o-", color=colours[i % len(colours)], ms=5, label=label)
    ax.set_title(title, pad=6)
    ax.locator_params(axis="y", nbins=5)
    if len(series) > 1:
        ax.legend(fontsize=8)


@matplotlib.rc_context(STYLE)
def bin_figure(title: str, loops: dict[str, list[dict[str, Any]]], metric: str) -> Figure:
    """Draw an error by the true depth as bars side by side.

    Args:
        title: What it is.
        loops: The rows of ``by_depth`` by the loop's name; at least one loop.
        metric: Key of an error in the rows.
    """
    figure, ax = new_figure(2.4, width=3.9)
    width, colours = 0.8 / len(loops), loop_colours(len(loops))
    for i, (label, rows) in enumerate(loops.items()):
        values = [np.nan if row.get(metric) is None else row[metric] for row in rows]
        ax.bar(np.arange(len(rows)) + (i + 0.5) * width - 0.4, values, 0.9 * width, color=colours[i], label=label)
    ax.set_xticks(range(len(rows)), [f"{row['from']:g}–{row['to']:g}" for row in rows], fontsize=8)
    ax.grid(False, axis="x")
    ax.set_title(title, pad=5)
    ax.set_xlabel("true depth (m)")
    ax.locator_params(axis="y", nbins=5)
    if len(loops) > 1:
        ax.legend(fontsize=8)
    return figure
