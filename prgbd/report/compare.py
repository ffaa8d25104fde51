"""Several runs side by side: one page and one table."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from prgbd.core.errors import DataError
from prgbd.io.files import atomic_path
from prgbd.report import ablation, figures, interactive, sections, tables
from prgbd.report.aligned import align
from prgbd.report.figures import Path3D
from prgbd.report.interactive import Cloud
from prgbd.report.reading import Run, open_run
from prgbd.report.rendering import Column, Table
from prgbd.report.style import CSS
from prgbd.report.words import describe, number

NAME = "comparison"
MOST_SETTINGS = 60
COLOURS = ("#2f7fc8", "#e0783a", "#12998b", "#c2528b", "#7a5fd0", "#9a8032", "#7d8794", "#b5442e")


def write_comparison(folders: list[Path], out: Path) -> tuple[list[Table], list[Path]]:
    """Write ``comparison.html``, ``.md``, ``.csv`` and ``.tex`` about runs, or about all runs below folders.

    Args:
        folders: Folders of runs, or of multiruns.
        out: Folder of the files; made if needed.

    Returns:
        The tables of figures and the four paths, the page first.

    Raises:
        DataError: If fewer than two finished runs are there.
    """
    paths = [path for folder in folders for path in ([folder] if _is_run(folder) else ablation.find_runs(folder))]
    finished = [path for path in dict.fromkeys(paths) if _is_run(path)]
    if len(finished) < 2:
        raise DataError(
            f"A comparison needs two finished runs and there is {'one' if finished else 'none'} in "
            f"{', '.join(map(str, folders))}; name the folders of runs, or of a multirun."
        )
    runs = [open_run(path) for path in finished]
    labels = _labels(finished)
    table = ablation.runs_table(finished, "Runs")
    for row, label in zip(table.rows, labels, strict=False):  # behind the runs there may be the paper
        row[0] = label
    out.mkdir(parents=True, exist_ok=True)
    settings = settings_table(finished, labels)
    written = [t for t in (table, settings) if t.rows]
    page = out / f"{NAME}.html"
    with atomic_path(page) as temporary:
        temporary.write_text(render(runs, labels, table, settings), encoding="utf-8")
    return written, [page, *ablation.write_tables(written, out, NAME)]


def _is_run(folder: Path) -> bool:
    return (folder / "summary.json").is_file()


def _labels(paths: list[Path]) -> list[str]:
    """Name runs by what was varied, and by their folders where that says nothing or too much."""
    labels = ablation.run_labels(paths)
    if max(map(len, labels)) <= 60 and len(set(labels)) == len(labels):
        return labels
    names = [path.name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def settings_table(paths: list[Path], labels: list[str]) -> Table:
    """Return the options that differ between runs, one row per option and one column per run."""
    options = [ablation.configuration(path) for path in paths]
    names = [k for k in dict.fromkeys(k for o in options for k in o) if len({o.get(k) for o in options}) > 1]
    names = [k for k in names if not ablation.NOT_VARIED.search(k)]
    table = Table("Settings that differ", [Column("option"), *(Column(label) for label in labels)])
    table.rows = [[name, *(o.get(name, "–") for o in options)] for name in names[:MOST_SETTINGS]]
    if len(names) > MOST_SETTINGS:
        table.note = f"The first {MOST_SETTINGS} of {len(names)} options that differ."
    return table


def render(runs: list[Run], labels: list[str], table: Table, settings: Table) -> str:
    """Return the page as HTML that needs no other file."""
    words = "".join(
        f"<li><b>{escape(label)}</b>: {escape(describe(run.summary)[0])}</li>"
        for label, run in zip(labels, runs, strict=True)
    )
    body = tables.to_html(table) + _trajectories(runs, labels)
    if settings.rows:
        body += "<h2>Settings</h2>" + tables.to_html(settings)
    links = "".join(
        f"<li>{escape(label)}: {escape(str(run.path))}</li>" for label, run in zip(labels, runs, strict=True)
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>Comparison of {len(runs)} runs</title><style>{CSS}</style>{interactive.scripts()}</head><body>"
        f'<header><p class="eyebrow">prgbd comparison</p><h1>{len(runs)} runs side by side</h1>'
        f"<ul>{words}</ul></header>"
        f"<main><h2>Figures</h2>{body}<h2>Folders</h2><ul class=files>{links}</ul></main></body></html>\n"
    )


def _trajectories(runs: list[Run], labels: list[str]) -> str:
    names = list(dict.fromkeys(name for run in runs for name in run.sequences))
    drawn = [(name, _sequence(runs, labels, name, f"c{i}-")) for i, name in enumerate(names[: sections.MOST_SEQUENCES])]
    html = "".join(f"<h3>{escape(name)}</h3>{picture}" for name, picture in drawn if picture)
    return f"<h2>Trajectories</h2>{html}" if html else ""


def _sequence(runs: list[Run], labels: list[str], name: str, key: str) -> str:
    """Draw the last kept trajectory of every run that has the sequence, over the truth or the first run's."""
    truth = next((t for t in (run.truth(name) for run in runs) if t is not None and len(t)), None)
    paths = [] if truth is None else [Path3D("truth", np.arange(len(truth)), truth.positions)]
    reference, clouds = truth, list[Cloud]()
    for number_, (run, label) in enumerate(zip(runs, labels, strict=True)):
        if not run.kept_loops or (result := run.result(run.kept_loops[-1], name)) is None:
            continue
        reference = result.trajectory if reference is None else reference
        found = align(result.trajectory, reference)
        if found is None:
            continue
        ate = ((run.kept_loops[-1].get("pose") or {}).get(name) or {}).get("ate_rmse")
        text = label + (f", {number(ate)} m" if ate is not None else "")
        xyz = found[0].points(result.trajectory.positions)
        paths.append(Path3D(text, result.trajectory.frame_index, xyz, COLOURS[number_ % len(COLOURS)]))
        if len(result.points):
            clouds.append(Cloud(text, found[0].points(result.points.xyz), result.points.rgb))
    if reference is None or len(paths) < 2:
        return ""
    axes, unit = figures.horizontal_axes(reference.wTc), "map units" if truth is None else "m"
    to = "the first run" if truth is None else "the truth"
    caption = f"The trajectory that each run keeps, Sim3-aligned to {to}; the figure beside a name is its ATE RMSE."
    return sections.trajectories_html(name, paths, clouds[-2:], None, axes, unit, caption, key)
