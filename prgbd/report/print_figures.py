"""Figures for a paper or a talk, as files: ``python -m prgbd.report RUN --figures pdf png``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.files import atomic_path
from prgbd.report import figures, pictures
from prgbd.report.aligned import aligned_sequence, estimates
from prgbd.report.curves import range_curves
from prgbd.report.drawing import STYLE, new_figure, to_bytes
from prgbd.report.pictures import DepthRow
from prgbd.report.reading import Run, first_and_last_samples, open_run
from prgbd.report.uncertainty import uncertainty_curves

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("pdf", "png", "svg")
DEFAULT = ("pdf", "png")
FOLDER = "figures"
MOST_FRAMES = 4  # of the depth maps


def write_figures(folder: Path | str, formats: Iterable[str] = DEFAULT) -> list[Path]:
    """Write the figures of a run into ``figures/`` in its folder.

    ``trajectory-SEQ`` has the truth, the baselines (SLAM on the images alone, the pose network) and the first and the
    kept loop, which is the paper's first figure; ``depth`` the depth maps before and after; ``METRIC-by-loop``,
    ``METRIC-by-cap``, ``METRIC-by-distance``, ``calibration-REFERENCE`` and ``sparsification-REFERENCE`` the curves of
    the report.

    Args:
        folder: The run folder.
        formats: Some of ``pdf``, ``png`` (300 dots per inch) and ``svg``.

    Returns:
        The files, in the order of the figures; none of what the run has no figures for.

    Raises:
        ConfigError: If a format is unknown.
        DataError: If the folder is no run, or the run has nothing to draw.
    """
    formats = list(dict.fromkeys(formats)) or list(DEFAULT)
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise ConfigError(f"There is no format '{unknown[0]}' of figures; choose {', '.join(FORMATS)}.")
    run = open_run(folder)
    written = []
    for name, figure in all_figures(run):
        for suffix in formats:
            path = run.path / FOLDER / f"{name}.{suffix}"
            with atomic_path(path) as temporary:
                temporary.write_bytes(to_bytes(figure, suffix))
            written.append(path)
    if not written:
        raise DataError(f"{run.path} has neither trajectories nor depth to draw; name the run of another task.")
    return written


def all_figures(run: Run) -> list[tuple[str, Figure]]:
    """Return the figures of a run with their names."""
    found: list[tuple[str, Figure | None]] = [(f"trajectory-{name}", _trajectory(run, name)) for name in run.sequences]
    found.append(("depth", _depth(run)))
    found += [(curve.name, curve.figure) for curve in (*range_curves(run), *uncertainty_curves(run))]
    return [(name, figure) for name, figure in found if figure is not None]


def _trajectory(run: Run, name: str) -> Figure | None:
    kept = run.kept_loops
    chosen = [*run.entries[: len(run.entries) - len(run.loops)], *kept[:1], *kept[1:][-1:]]
    found = estimates(run, name, chosen)
    if not found:
        return None
    drawn = aligned_sequence(name, found, run.truth(name))
    return figures.trajectory_figure(drawn.paths, drawn.axes, None, drawn.unit) if drawn.paths else None


def _depth(run: Run) -> Figure | None:
    rows = pictures.depth_rows(first_and_last_samples(run), MOST_FRAMES)
    return depth_figure(rows) if rows else None


@matplotlib.rc_context(STYLE)
def depth_figure(rows: list[DepthRow]) -> Figure:
    """Draw frames below each other: image, truth where known, and the predictions with their Abs Rel.

    Args:
        rows: The frames, at least one, all with the same predictions.
    """
    from matplotlib.patheffects import withStroke

    columns: list[list[tuple[str, NDArray[Any], str]]] = []
    for row in rows:
        cells = [("image", row.image, "")]
        cells += [] if row.truth is None else [("truth", row.truth, "")]
        cells += [(p.label, p.picture, "" if p.abs_rel is None else f"{p.abs_rel:.3f}") for p in row.predictions]
        columns.append(cells)
    across, (height, width) = max(map(len, columns)), rows[0].image.shape[:2]
    size = 7.0 / across  # inches; as wide as the text of a page in two columns
    figure, grid = new_figure(0.25 + len(rows) * size * height / width, len(rows), across, width=7.0, squeeze=False)
    for axes, cells in zip(grid, columns, strict=True):
        for ax, cell in zip(axes, cells, strict=False):
            ax.imshow(cell[1], interpolation="none")
            text = ax.text(0.98, 0.04, cell[2], transform=ax.transAxes, ha="right", color="white", fontsize=8)
            text.set_path_effects([withStroke(linewidth=1.5, foreground="black")])  # readable on any colour
        for ax in axes:
            ax.set_axis_off()
    for ax, cell in zip(grid[0], columns[int(np.argmax([len(cells) for cells in columns]))], strict=False):
        ax.set_title(cell[0], fontsize=9, loc="center", pad=3)
    figure.set_layout_engine("constrained", w_pad=0.01, h_pad=0.01, wspace=0.01, hspace=0.01)
    return figure
