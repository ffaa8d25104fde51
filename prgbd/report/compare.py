"""Several runs side by side: one page and one table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prgbd.core.errors import DataError
from prgbd.io.files import atomic_path
from prgbd.report.ablation import runs_table
from prgbd.report.aligned import aligned_sequence, ate_of
from prgbd.report.figures import Estimate
from prgbd.report.interactive import View
from prgbd.report.joined import with_joined
from prgbd.report.labels import configuration, find_runs, is_run, run_labels, varied
from prgbd.report.reading import Run, open_run
from prgbd.report.rendering import write_tables
from prgbd.report.sequences import MOST_SEQUENCES, trajectory_view
from prgbd.report.table import Table, choose_columns
from prgbd.report.templates import render
from prgbd.report.words import describe

NAME = "comparison"
MOST_SETTINGS = 60
LONGEST_LABEL = 60  # characters
COLOURS = ("#2f7fc8", "#e0783a", "#12998b", "#c2528b", "#7a5fd0", "#9a8032", "#7d8794", "#b5442e")


def write_comparison(folders: Sequence[Path], out: Path, columns: Sequence[str] = ()) -> tuple[list[Table], list[Path]]:
    """Write ``comparison.html``, ``.md``, ``.csv`` and ``.tex`` about runs, or about all runs below folders.

    Args:
        folders: Folders of runs, or of multiruns.
        out: Folder of the files; made if needed.
        columns: Names of the columns of figures to show, see ``choose_columns``; all by default.

    Returns:
        The tables of figures and the four paths, the page first.

    Raises:
        DataError: If fewer than two finished runs are there.
        ConfigError: If there is no such column.
    """
    paths = [path for folder in folders for path in ([folder] if is_run(folder) else find_runs(folder))]
    finished = [path for path in dict.fromkeys(paths) if is_run(path)]
    if len(finished) < 2:
        raise DataError(
            f"A comparison needs two finished runs and there is {'one' if finished else 'none'} in "
            f"{', '.join(map(str, folders))}; name the folders of runs, or of a multirun."
        )
    labels = _labels(finished)
    each, *joined = with_joined(runs_table(finished, "Runs"))
    each.frame.loc[: len(labels) - 1, "run"] = labels  # behind the runs there may be the paper
    tables = choose_columns([each, *joined], columns)
    settings = settings_table(finished, labels)
    out.mkdir(parents=True, exist_ok=True)
    page = out / f"{NAME}.html"
    with atomic_path(page) as temporary:
        temporary.write_text(_page([open_run(path) for path in finished], labels, tables, settings), encoding="utf-8")
    tables += [] if settings.frame.empty else [settings]
    return tables, [page, *write_tables(tables, out, NAME)]


def _labels(paths: list[Path]) -> list[str]:
    """Name runs by what was varied, and by their folders where that says nothing or too much."""
    labels = run_labels(paths)
    if max(map(len, labels)) <= LONGEST_LABEL and len(set(labels)) == len(labels):
        return labels
    names = [path.name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def settings_table(paths: Sequence[Path], labels: Sequence[str]) -> Table:
    """Return the options that differ between runs, one row per option and one column per run."""
    options = varied([configuration(path) for path in paths]).fillna("–").T
    shown = options[:MOST_SETTINGS].set_axis(list(labels), axis=1).rename_axis("option").reset_index()
    left_out = len(options) > MOST_SETTINGS
    note = f"The first {MOST_SETTINGS} of {len(options)} options that differ." if left_out else ""
    return Table("Settings that differ", shown, note=note)


def _page(runs: list[Run], labels: list[str], tables: list[Table], settings: Table) -> str:
    """Return the page as HTML that needs no other file."""
    names = list(dict.fromkeys(name for run in runs for name in run.sequences))[:MOST_SEQUENCES]
    views = [(name, _view(runs, labels, name)) for name in names]
    return render(
        "comparison.html",
        runs=[(label, run.path, describe(run.summary)[0]) for label, run in zip(labels, runs, strict=True)],
        tables=tables,
        views=[(name, view) for name, view in views if view],
        settings=settings,
    )


def _view(runs: list[Run], labels: list[str], name: str) -> View | None:
    """Draw the last kept trajectory of every run that has the sequence, over the truth or the first run's."""
    truth = next((t for t in (run.truth(name) for run in runs) if t is not None and len(t)), None)
    found = [
        Estimate(label, COLOURS[i % len(COLOURS)], result, ate_of(run.kept_loops[-1], name))
        for i, (run, label) in enumerate(zip(runs, labels, strict=True))
        if run.kept_loops and (result := run.result(run.kept_loops[-1], name)) is not None
    ]
    if not found:
        return None
    drawn = aligned_sequence(name, found, truth)
    if len(drawn.paths) < 2:
        return None
    to = "the truth" if drawn.has_truth else "the first run"
    caption = f"The trajectory that each run keeps, Sim3-aligned to {to}; the figure beside a name is its ATE RMSE."
    return trajectory_view(drawn, caption)
