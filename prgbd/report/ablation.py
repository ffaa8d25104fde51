"""Tables out of several runs: which option led to which error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from prgbd.core.errors import DataError
from prgbd.report import depth_metrics
from prgbd.report.joined import with_joined
from prgbd.report.labels import find_runs, run_labels
from prgbd.report.paper import published_ablation, published_refinement
from prgbd.report.reading import Run, judged_sequences, kept_loops, mean_pose, open_run, sum_pose
from prgbd.report.rendering import write_tables
from prgbd.report.table import Cell, Table, choose_columns
from prgbd.report.words import depth_basis

RANGES = ("near", "far")  # below and beyond half of the depth cap
# Columns for which the paper may have a figure, with its key in ``published_refinement``.
_PUBLISHED = {"ATE first (m)": "ate_first", "ATE last (m)": "ate_last", "Abs Rel first": "abs_rel_first"}
_PUBLISHED |= {"Sq Rel first": "sq_rel_first", **{title: key for key, title in depth_metrics.TITLES.items()}}
_BEST = dict.fromkeys(["ATE first (m)", "ATE last (m)", "Abs Rel first", "Sq Rel first"], "min") | depth_metrics.BEST
_BEST |= {f"Sq Rel {part} {when}": "min" for part in RANGES for when in ("first", "last")}


def join(folder: Path | str, columns: Sequence[str] = ()) -> list[Path]:
    """Join the runs below a folder into tables and write ``ablation.md``, ``ablation.csv`` and ``ablation.tex``.

    Args:
        folder: Holds the runs.
        columns: Names of the columns to write, see ``choose_columns``; all by default.

    Returns:
        The three paths.

    Raises:
        DataError: If there is no run below the folder.
        ConfigError: If there is no such column.
    """
    return write_tables(choose_columns(ablation_tables(folder), columns), Path(folder), "ablation")


def ablation_tables(folder: Path | str) -> list[Table]:
    """Return the table of the runs below a folder, and what ``with_joined`` makes of several seeds and recordings.

    Raises:
        DataError: If there is no run below the folder.
    """
    paths = find_runs(folder)
    if not paths and (Path(folder) / "config.yaml").is_file():
        raise DataError(f"The run in {folder} has no figures yet; go on with it: python -m prgbd resume={folder}")
    if not paths:
        what = "There is no run below" if Path(folder).is_dir() else "There is no folder"
        raise DataError(f"{what} {folder}; name the folder of a finished run or of a multirun.")
    return with_joined(runs_table(paths, "Ablation"))


def runs_table(paths: Sequence[Path], title: str) -> Table:
    """Return a table with one row per run, labelled by what was varied; a run that did not finish has an empty row.

    Args:
        paths: Folders of runs.
        title: Of the table.
    """
    labels, runs = run_labels(paths), [_opened(path) for path in paths]
    finished = [run for run in runs if run]
    with_paper = any(published_ablation(label) for label in labels)
    rows = [
        {"run": label} | (_cells(run.summary) if run else {}) | _paper_cells(label)
        for label, run in zip(labels, runs, strict=True)
    ]
    note = _note(finished, with_paper)
    unfinished = [label for label, run in zip(labels, runs, strict=True) if run is None]
    if unfinished:
        note += f" Did not finish: {', '.join(unfinished)}."
    table = Table.of(title, rows, best=_BEST, note=note, contenders=len(rows))
    paper = None if with_paper else _paper_row(finished, table)
    if paper is None:
        return table
    note += " Paper: Monodepth2 before, pRGBD-Refined after the loops, on the whole test set."
    return Table.of(title, [*rows, paper], best=_BEST, note=note, contenders=len(rows))


def _opened(path: Path) -> Run | None:
    try:
        return open_run(path)
    except DataError:
        return None


def _paper_cells(label: str) -> dict[str, Cell]:
    """Return what the paper reached with the loss that a label names."""
    published = published_ablation(label)
    return dict(zip(("Sq Rel (paper)", "RMSE (paper)"), published, strict=True)) if published else {}


def _paper_row(runs: list[Run], table: Table) -> dict[str, Cell] | None:
    """Return what the paper reached on the data of all runs, for the columns in which a run has a figure."""
    evaluated = {(run.summary.get("data"), tuple(_judged(run.summary))) for run in runs}
    if len(evaluated) != 1:
        return None
    published = published_refinement(*evaluated.pop())
    row: dict[str, Cell] = {title: published[key] for title, key in _PUBLISHED.items() if key in published}
    row = {title: figure for title, figure in row.items() if title in table.frame}
    return {"run": "Tiwari et al. (paper)", **row} if row else None


def _judged(summary: dict[str, Any]) -> list[str]:
    return judged_sequences(summary) or [str(name) for name in summary.get("sequences") or []]


def _cells(summary: dict[str, Any]) -> dict[str, Cell]:
    loops = kept_loops(summary)
    if not loops:
        return {"loops": 0}
    first, last, judged = loops[0], loops[-1], judged_sequences(summary)
    frames = sum_pose(last, "frames", judged)
    depths = [d for d in (loop.get("depth") for loop in loops) if d and d.get("images")]
    before, after = (depths[0], depths[-1]) if depths else ({}, {})
    return {
        "loops": len(loops) - 1,
        "tracked": f"{sum_pose(last, 'tracked_frames', judged) or 0}/{frames}" if frames else None,
        "ATE first (m)": mean_pose(first, "ate_rmse", judged),
        "ATE last (m)": mean_pose(last, "ate_rmse", judged),
        "Abs Rel first": before.get("abs_rel"),
        "Sq Rel first": before.get("sq_rel"),
        **{title: after.get(key) for key, title in depth_metrics.TITLES.items()},
        **{
            f"Sq Rel {part} {when}": (depth.get(part) or {}).get("sq_rel")
            for part in RANGES
            for when, depth in (("first", before), ("last", after))
        },
    }


def _note(runs: list[Run], with_paper: bool) -> str:
    loops = [loop for run in runs for loop in run.loops]
    kinds = {str(pose.get("alignment")) for loop in loops for pose in (loop.get("pose") or {}).values()}
    measured = [loop["depth"] for loop in loops if (loop.get("depth") or {}).get("images")]
    protocols = {depth_basis(depth).removeprefix("Abs Rel, ") for depth in measured}
    parts = ["First: before any refinement; last: after the last loop that is kept."]
    if kinds:
        which = "test sequences" if any(judged_sequences(run.summary) for run in runs) else "sequences"
        parts.append(f"ATE RMSE, alignment {' and '.join(sorted(kinds))}, mean over {which}.")
    if protocols:
        parts.append(f"Depth after the last loop: {'; '.join(sorted(protocols))}.")
    if with_paper:
        parts.append("Paper: KITTI Eigen after the first loop; other data, so compare the order of the rows.")
    return " ".join(parts)
