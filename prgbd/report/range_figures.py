"""Figures of depth errors by cap, by distance, and by loop with one line per cap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np

from prgbd.report.drawing import STYLE, loop_colours, new_figure
from prgbd.report.figures import metric_figure
from prgbd.report.reading import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


TITLES = {"abs_rel": "Abs Rel", "sq_rel": "Sq Rel (m)", "rmse": "RMSE (m)", "a1": "δ<1.25"}


@dataclass(frozen=True)
class Curve:
    """A figure of depth errors.

    Attributes:
        name: For a file, such as ``abs_rel-by-cap``.
        label: In words.
        figure: The figure.
    """

    name: str
    label: str
    figure: Figure


def range_curves(run: Run) -> list[Curve]:
    """Return the curves that a run has figures for: by cap and distance for its first and last network, and by loop."""
    known = [(run.label(loop), loop["depth"]) for loop in run.loops if (loop.get("depth") or {}).get("images")]
    chosen = known if len(known) < 2 else [known[0], known[-1]]
    found = [(label, colour, depth) for (label, depth), colour in zip(chosen, loop_colours(len(chosen)), strict=True)]
    return [*_by_cap(found), *_by_distance(found), *_by_loop(run)]


def _differ(rows: list[dict[str, Any]] | None) -> bool:
    """Whether the caps tell anything: in a room all truth is nearer than the smallest, and all figures are one."""
    return len({tuple(row.get(metric) for metric in TITLES) for row in rows or []}) > 1


def _filled(depth: dict[str, Any]) -> int:
    """How many ranges of distance there are up to the last one that has truth."""
    return max((i + 1 for i, row in enumerate(depth.get("by_depth") or []) if row.get("pixels")), default=0)


def _by_cap(found: list[tuple[str, str, dict[str, Any]]]) -> Iterator[Curve]:
    found = [entry for entry in found if _differ(entry[2].get("by_cap"))]
    for metric in ("abs_rel", "rmse", "a1") if found else ():
        curves = [
            (label, colour, [row["cap"] for row in depth["by_cap"]], [row.get(metric) for row in depth["by_cap"]])
            for label, colour, depth in found
        ]
        title = TITLES[metric]
        yield Curve(f"{metric}-by-cap", f"{title} by depth cap", cap_figure(f"{title} by cap", curves))


def _by_distance(found: list[tuple[str, str, dict[str, Any]]]) -> Iterator[Curve]:
    filled = max((_filled(depth) for *_, depth in found), default=0)
    bins = [(label, colour, depth["by_depth"][:filled]) for label, colour, depth in found if depth.get("by_depth")]
    for metric in ("abs_rel", "rmse") if bins and filled > 1 else ():
        title = TITLES[metric]
        figure = bin_figure(f"{title} by distance", bins, metric)
        yield Curve(f"{metric}-by-distance", f"{title} by true depth", figure)


def _by_loop(run: Run) -> Iterator[Curve]:
    """Yield the paper's curves: metrics over the loops, one line per cap."""
    found = [(loop.get("depth") or {}).get("by_cap") or [] for loop in run.loops]
    caps = list(dict.fromkeys(row["cap"] for rows in found for row in rows if _differ(rows)))
    for metric in ("abs_rel", "sq_rel", "rmse") if len(found) > 1 and caps else ():
        curves = {
            f"{cap:g} m": [next((row.get(metric) for row in rows if row["cap"] == cap), None) for rows in found]
            for cap in caps
        }
        title = TITLES[metric]
        label = f"{title} by loop, a line per depth cap"
        yield Curve(f"{metric}-by-loop", label, metric_figure(f"{title} by loop and cap", curves, ordered=True))


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
        metric: ``abs_rel`` or ``rmse``.
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
