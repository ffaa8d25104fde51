"""Figures of depth errors by cap and by distance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np

from prgbd.report.figures import STYLE, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
