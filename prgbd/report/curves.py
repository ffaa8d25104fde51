"""The curves of a run: every figure over the loops, and depth errors by cap, by distance, and by loop and cap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np

from prgbd.report.depth_metrics import WITH_UNITS
from prgbd.report.drawing import STYLE, Drawing, loop_colours, new_figure
from prgbd.report.figures import metric_figure
from prgbd.report.reading import Run, mean_pose

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_LINES = 8  # sequences in one panel
_Found = list[tuple[str, str, dict[str, Any]]]  # label, colour and depth figures of a loop


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
    found = [(label, colour, depth) for (label, depth), colour in zip(chosen, loop_colours(len(chosen)), strict=True)]
    return [*_by_cap(found), *_by_distance(found), *_by_loop(run)]


def _differ(rows: list[dict[str, Any]] | None) -> bool:
    """Whether the caps tell anything: in a room all truth is nearer than the smallest, and all figures are one."""
    return len({tuple(row.get(metric) for metric in WITH_UNITS) for row in rows or []}) > 1


def _filled(depth: dict[str, Any]) -> int:
    """How many ranges of distance there are up to the last one that has truth."""
    return max((i + 1 for i, row in enumerate(depth.get("by_depth") or []) if row.get("pixels")), default=0)


def _by_cap(found: _Found) -> Iterator[Drawing]:
    found = [entry for entry in found if _differ(entry[2].get("by_cap"))]
    for metric, title in WITH_UNITS.items() if found else ():
        curves = [
            (label, colour, [row["cap"] for row in depth["by_cap"]], [row.get(metric) for row in depth["by_cap"]])
            for label, colour, depth in found
        ]
        if any(_any(values) for *_, values in curves):
            figure = cap_figure(f"{title} by cap", curves)
            yield Drawing(f"{title} by depth cap", figure, name=f"{metric}-by-cap")


def _by_distance(found: _Found) -> Iterator[Drawing]:
    filled = max((_filled(depth) for *_, depth in found), default=0)
    bins = [(label, colour, depth["by_depth"][:filled]) for label, colour, depth in found if depth.get("by_depth")]
    for metric, title in WITH_UNITS.items() if bins and filled > 1 else ():
        if any(_any([row.get(metric) for row in rows]) for *_, rows in bins):
            figure = bin_figure(f"{title} by distance", bins, metric)
            yield Drawing(f"{title} by true depth", figure, name=f"{metric}-by-distance")


def _by_loop(run: Run) -> Iterator[Drawing]:
    """Yield the paper's curves: metrics over the loops, one line per cap."""
    found = [(loop.get("depth") or {}).get("by_cap") or [] for loop in run.loops]
    caps = list(dict.fromkeys(row["cap"] for rows in found for row in rows if _differ(rows)))
    for metric, title in WITH_UNITS.items() if len(found) > 1 and caps else ():
        lines = {
            f"{cap:g} m": [next((row.get(metric) for row in rows if row["cap"] == cap), None) for rows in found]
            for cap in caps
        }
        if any(map(_any, lines.values())):
            figure = metric_figure(f"{title} by loop and cap", lines, ordered=True)
            yield Drawing(f"{title} by loop, a line per depth cap", figure, name=f"{metric}-by-loop")


@matplotlib.rc_context(STYLE)
def cap_figure(title: str, curves: Sequence[tuple[str, str, list[float], list[float | None]]]) -> Figure:
    """Draw a metric over the cap; each curve is ``(label, colour, caps, values)``, a value None leaves a gap."""
    figure, ax = new_figure(2.4, width=3.9)
    for label, colour, caps, values in curves:
        y = np.array([np.nan if value is None else value for value in values])
        ax.plot(caps, y, "o-", color=colour, ms=4.5, label=label)
    ax.set_title(title, pad=5)
    ax.set_xlabel("cap (m)")
    ax.locator_params(axis="y", nbins=5)
    if len(curves) > 1:
        ax.legend(fontsize=8)
    return figure


@matplotlib.rc_context(STYLE)
def bin_figure(title: str, loops: Sequence[tuple[str, str, list[dict[str, Any]]]], metric: str) -> Figure:
    """Draw an error by the true depth as bars side by side.

    Args:
        title: What it is.
        loops: ``(label, colour, rows)`` with the rows of ``by_depth``.
        metric: Key of an error in the rows.
    """
    figure, ax = new_figure(2.4, width=3.9)
    width = 0.8 / max(len(loops), 1)
    for i, (label, colour, rows) in enumerate(loops):
        values = [np.nan if row.get(metric) is None else row[metric] for row in rows]
        ax.bar(np.arange(len(rows)) + (i + 0.5) * width - 0.4, values, 0.9 * width, color=colour, label=label)
    rows = loops[0][2] if loops else []
    ax.set_xticks(range(len(rows)), [f"{row['from']:g}–{row['to']:g}" for row in rows], fontsize=8)
    ax.grid(False, axis="x")
    ax.set_title(title, pad=5)
    ax.set_xlabel("true depth (m)")
    ax.locator_params(axis="y", nbins=5)
    if len(loops) > 1:
        ax.legend(fontsize=8)
    return figure
