"""Tables out of several runs: which option led to which error."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from prgbd.core.errors import DataError
from prgbd.io.files import atomic_path
from prgbd.report import tables
from prgbd.report.paired import means_over_recordings, paired_differences
from prgbd.report.paper import published_ablation, published_refinement
from prgbd.report.reading import Run, judged_sequences, kept_loops, mean_pose, open_run, sum_pose
from prgbd.report.tables import Cell, Column, Table
from prgbd.report.words import depth_basis

RANGES = ("near", "far")  # below and beyond half of the depth cap

# Options that differ between runs without being what was varied.
NOT_VARIED = re.compile(r"^(hydra|run|out|output_dir|resume|progress|debug)(\.|$)")


def find_runs(folder: Path | str) -> list[Path]:
    """Return the run folders at most three levels below ``folder``, in natural order (2 before 10).

    A folder with a ``config.yaml`` but no ``summary.json`` is a run that did not finish, and is returned as well.
    """
    folder = Path(folder)
    found = {
        p.parent
        for depth in ("*", "*/*", "*/*/*")
        for name in ("summary.json", "config.yaml")
        for p in folder.glob(f"{depth}/{name}")
        if not any(part.startswith(".") for part in p.relative_to(folder).parts)
    }
    outermost = [p for p in found if not any(parent in found for parent in p.parents)]
    return sorted(outermost, key=lambda p: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", str(p))])


def join(folder: Path | str) -> tuple[Path, Path, Path]:
    """Join the runs below a folder into tables and write ``ablation.md``, ``ablation.csv`` and ``ablation.tex``.

    Returns:
        The three paths.

    Raises:
        DataError: If there is no run below the folder.
    """
    folder = Path(folder)
    return write_tables(ablation_tables(folder), folder, "ablation")


def write_tables(written: list[Table], folder: Path, name: str) -> tuple[Path, Path, Path]:
    """Write tables one below the other as ``NAME.md``, ``NAME.csv`` and ``NAME.tex``; return the three paths."""
    paths = folder / f"{name}.md", folder / f"{name}.csv", folder / f"{name}.tex"
    for path, render in zip(paths, (tables.to_markdown, tables.to_csv, tables.to_latex), strict=True):
        with atomic_path(path) as temporary:
            temporary.write_text("\n".join(render(table) for table in written), encoding="utf-8")
    return paths


def ablation_tables(folder: Path | str) -> list[Table]:
    """Return the table of the runs below a folder, and where recordings were varied too, their means and differences.

    Raises:
        DataError: If there is no run below the folder.
    """
    paths = find_runs(folder)
    if not paths and (Path(folder) / "config.yaml").is_file():
        raise DataError(f"The run in {folder} has no figures yet; go on with it: python -m prgbd resume={folder}")
    if not paths:
        what = "There is no run below" if Path(folder).is_dir() else "There is no folder"
        raise DataError(f"{what} {folder}; name the folder of a finished run or of a multirun.")
    table = runs_table(paths, "Ablation")
    means = means_over_recordings(table)
    if means is None:
        return [table]
    differences = paired_differences(table)
    table.columns = [Column(column.title) for column in table.columns]  # a recording is not better than another
    return [table, means] if differences is None else [table, means, differences]


def runs_table(paths: list[Path], title: str) -> Table:
    """Return a table with one row per run, labelled by what was varied; a run that did not finish has an empty row.

    Args:
        paths: Folders of runs.
        title: Of the table.
    """
    runs = [_opened(path) for path in paths]
    labels = run_labels(paths)
    columns = _columns()
    table = Table(title, columns)
    for label, run in zip(labels, runs, strict=True):
        published = published_ablation(label) or (None, None)
        table.rows.append([label, *(_cells(run.summary) if run else [None] * (len(columns) - 3)), *published])
    table.contenders = len(table.rows)
    finished = [run for run in runs if run]
    with_paper = any(published_ablation(label) for label in labels)
    table.note = _note(finished, with_paper)
    unfinished = [label for label, run in zip(labels, runs, strict=True) if run is None]
    if unfinished:
        table.note += f" Did not finish: {', '.join(unfinished)}."
    paper = None if with_paper else _paper_row(finished, table)
    if paper is not None:
        table.rows.append(paper)
        table.note += " Paper: Monodepth2 before, pRGBD-Refined after the loops, on the whole test set."
    return table.without_empty_columns()


def _opened(path: Path) -> Run | None:
    try:
        return open_run(path)
    except DataError:
        return None


def _columns() -> list[Column]:
    metrics = [
        Column(tables.DEPTH_TITLES[k], "max" if k in tables.HIGHER_IS_BETTER else "min") for k in tables.DEPTH_TITLES
    ]
    pose = [Column("tracked"), Column("ATE first (m)", "min"), Column("ATE last (m)", "min")]
    ranges = [Column(f"Sq Rel {part} {when}", "min") for part in RANGES for when in ("first", "last")]
    paper = [Column("Sq Rel (paper)"), Column("RMSE (paper)")]
    before = [Column("Abs Rel first", "min"), Column("Sq Rel first", "min")]
    return [Column("run"), Column("loops"), *pose, *before, *metrics, *ranges, *paper]


def _paper_row(runs: list[Run], table: Table) -> list[Cell] | None:
    """Return what the paper reached on the data of all runs, for the columns in which a run has a figure."""
    evaluated = {(run.summary.get("data"), tuple(_judged(run.summary))) for run in runs}
    if len(evaluated) != 1:
        return None
    published = published_refinement(*evaluated.pop())
    keys = ["", "", "", "ate_first", "ate_last", "abs_rel_first", "sq_rel_first", *tables.DEPTH_TITLES]
    row: list[Cell] = [published.get(key) for key in keys]
    row += [None] * (len(table.columns) - len(row))
    for i in range(len(row)):
        if all(other[i] is None for other in table.rows):
            row[i] = None
    if all(cell is None for cell in row):
        return None
    row[0] = "Tiwari et al. (paper)"
    return row


def _judged(summary: dict[str, Any]) -> list[str]:
    return judged_sequences(summary) or [str(name) for name in summary.get("sequences") or []]


def _cells(summary: dict[str, Any]) -> list[Cell]:
    loops = kept_loops(summary)
    if not loops:
        return [0, *[None] * (5 + len(tables.DEPTH_TITLES) + 2 * len(RANGES))]
    first, last, judged = loops[0], loops[-1], judged_sequences(summary)
    frames = sum_pose(last, "frames", judged)
    tracked = f"{sum_pose(last, 'tracked_frames', judged) or 0}/{frames}" if frames else None
    depths = [d for d in (loop.get("depth") for loop in loops) if d and d.get("images")]
    before, after = (depths[0], depths[-1]) if depths else ({}, {})
    return [
        len(loops) - 1,
        tracked,
        mean_pose(first, "ate_rmse", judged),
        mean_pose(last, "ate_rmse", judged),
        before.get("abs_rel"),
        before.get("sq_rel"),
        *[after.get(k) for k in tables.DEPTH_TITLES],
        *[(depth.get(part) or {}).get("sq_rel") for part in RANGES for depth in (before, after)],
    ]


def _note(runs: list[Run], with_paper: bool) -> str:
    kinds = {
        str(pose.get("alignment")) for run in runs for loop in run.loops for pose in (loop.get("pose") or {}).values()
    }
    protocols = {
        depth_basis(loop["depth"]).removeprefix("Abs Rel, ")
        for run in runs
        for loop in run.loops
        if (loop.get("depth") or {}).get("images")
    }
    parts = ["First: before any refinement; last: after the last loop that is kept."]
    if kinds:
        which = "test sequences" if any(judged_sequences(run.summary) for run in runs) else "sequences"
        parts.append(f"ATE RMSE, alignment {' and '.join(sorted(kinds))}, mean over {which}.")
    if protocols:
        parts.append(f"Depth after the last loop: {'; '.join(sorted(protocols))}.")
    if with_paper:
        parts.append("Paper: KITTI Eigen after the first loop; other data, so compare the order of the rows.")
    return " ".join(parts)


def run_labels(paths: list[Path]) -> list[str]:
    """Name each run by what differs: overrides, else choices of groups, else options, else the folders."""
    for read in (_overrides, _choices, configuration):
        options = [read(path) for path in paths]
        if not any(options):
            continue
        varied = [k for k in dict.fromkeys(k for o in options for k in o) if len({o.get(k) for o in options}) > 1]
        varied = [k for k in varied if not NOT_VARIED.search(k)]
        labels = [", ".join(f"{k}={o[k]}" for k in varied if k in o) for o in options]
        if all(labels) and len(set(labels)) == len(labels):
            return labels
    return [path.name for path in paths]


def _overrides(path: Path) -> dict[str, str]:
    """Return the overrides that were noted for a job, as Hydra does."""
    items = _yaml(path / ".hydra" / "overrides.yaml")
    if not isinstance(items, list):
        return {}
    pairs = [str(item).lstrip("+~").split("=", 1) for item in items]
    return {pair[0]: pair[1] for pair in pairs if len(pair) == 2}


def _choices(path: Path) -> dict[str, str]:
    """Return what was chosen from each group, which a run notes in its configuration."""
    config = _yaml(path / "config.yaml")
    notes = config.get("run") if isinstance(config, dict) else None
    choices = notes.get("choices") if isinstance(notes, dict) else None
    return {str(k): str(v) for k, v in choices.items()} if isinstance(choices, dict) else {}


def configuration(path: Path) -> dict[str, str]:
    """Return all options of a run, ``a.b`` -> text; empty where its ``config.yaml`` cannot be read."""
    config = _yaml(path / "config.yaml")
    return dict(_flat("", config)) if isinstance(config, dict) else {}


def _flat(prefix: str, config: dict[Any, Any]) -> list[tuple[str, str]]:
    out: list[tuple[str, str]] = []
    for key, value in config.items():
        name = f"{prefix}{key}"
        out += _flat(name + ".", value) if isinstance(value, dict) and value else [(name, str(value))]
    return out


def _yaml(path: Path) -> Any:
    from omegaconf import OmegaConf

    try:
        return OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    except Exception:  # a label is no reason to lose a table, and the YAML parsers have many exceptions
        return None
