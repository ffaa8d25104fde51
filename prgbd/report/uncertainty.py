"""The curves that show whether a network knows how wrong it is: calibration and sparsification."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import matplotlib

from prgbd.report.drawing import MUTED, STYLE, Drawing, loop_colours, new_figure
from prgbd.report.reading import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AGAINST = {"truth": "true depth", "points": "triangulated points"}
"""What ``summary.json`` compares with, in words."""
_Found = dict[str, dict[str, Any]]  # label of a loop and its figures


def uncertainty_curves(run: Run) -> list[Drawing]:
    """Return the curves of the first and the last network that predicts deviations, by what it is compared with."""
    known = [(run.label(loop), loop["uncertainty"]) for loop in run.loops if loop.get("uncertainty")]
    chosen = known if len(known) < 2 else [known[0], known[-1]]
    return [drawing for name in AGAINST for drawing in _curves(name, {k: f[name] for k, f in chosen if f.get(name)})]


def _curves(name: str, found: _Found) -> Iterator[Drawing]:
    for kind, draw in (("calibration", calibration_figure), ("sparsification", sparsification_figure)):
        lines = {label: figures for label, figures in found.items() if figures.get(kind)}
        if lines:
            title = f"{kind.capitalize()}, {AGAINST[name]}"
            yield Drawing(
                f"{kind} of the uncertainty against {AGAINST[name]}", draw(title, lines), name=f"{kind}-{name}"
            )


@matplotlib.rc_context(STYLE)
def calibration_figure(title: str, found: _Found) -> Figure:
    """Draw the observed over the nominal share of errors.

    Args:
        title: What it is.
        found: Figures of ``UncertaintyEvaluation`` by the loop's name.
    """
    figure, ax = new_figure(2.6, width=3.9)
    ax.plot([0, 1], [0, 1], "--", color=MUTED, lw=1)
    _lines(ax, found, "calibration", "nominal", "observed")
    ax.set(xlim=(0, 1), ylim=(0, 1), xlabel="nominal share", ylabel="share of errors")
    return _finished(figure, ax, title)


@matplotlib.rc_context(STYLE)
def sparsification_figure(title: str, found: _Found) -> Figure:
    """Draw the mean error that is left over the share of pixels removed, and the least that could be.

    Args:
        title: What it is.
        found: Figures of ``UncertaintyEvaluation`` by the loop's name.
    """
    figure, ax = new_figure(2.6, width=3.9)
    _lines(ax, found, "sparsification", "removed", "error")
    _lines(ax, found, "sparsification", "removed", "best", "--")
    ax.set(xlim=(0, 1), xlabel="share of pixels removed", ylabel="mean error left")
    ax.set_ylim(bottom=0)
    return _finished(figure, ax, title)


def _lines(ax: Axes, found: _Found, kind: str, x: str, y: str, style: str = "-") -> None:
    for (label, figures), colour in zip(found.items(), loop_colours(len(found)), strict=True):
        rows = [row for row in figures[kind] if row.get(x) is not None and row.get(y) is not None]
        name = label if style == "-" else "_" + label  # no legend of its own
        ax.plot([row[x] for row in rows], [row[y] for row in rows], style, color=colour, label=name)


def _finished(figure: Figure, ax: Axes, title: str) -> Figure:
    ax.set_title(title, pad=6)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        ax.legend(fontsize=8)
    return figure
