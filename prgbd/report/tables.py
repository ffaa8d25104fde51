"""The tables of a run: its loops, its poses by sequence, its depth, and every figure as CSV."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prgbd.io.files import atomic_path
from prgbd.report.paper import published_depth, published_pose
from prgbd.report.reading import loop_name, mean_pose, sum_pose
from prgbd.report.rendering import Cell, Column, Table, to_csv, to_html, to_latex, to_markdown, to_rich
from prgbd.report.words import ALIGNMENT_WORDS, depth_basis, describe, number

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "Cell",
    "Column",
    "Table",
    "depth_table",
    "loops_table",
    "metrics_rows",
    "pose_table",
    "print_summary",
    "to_csv",
    "to_html",
    "to_latex",
    "to_markdown",
    "to_rich",
    "write_metrics_csv",
]

DEPTH_TITLES = {
    "abs_rel": "Abs Rel",
    "sq_rel": "Sq Rel",
    "rmse": "RMSE",
    "rmse_log": "RMSE log",
    "a1": "δ<1.25",
    "a2": "δ<1.25²",
    "a3": "δ<1.25³",
}
EIGEN_IMAGES = 697  # test images of the Eigen split
HIGHER_IS_BETTER = {"a1", "a2", "a3"}


def loops_table(summary: dict[str, Any]) -> Table:
    """Return the table of a run's baselines and loops: what each reached and what it learned from.

    Figures are means over sequences; those of training and of test sequences stand apart where a run has both.
    """
    test = [str(name) for name in summary.get("test_sequences") or []]
    low = [
        ("ATE RMSE (m)", "min"),
        ("ATE, test (m)", "min"),
        ("RPE (m)", "min"),
        ("RPE, test (m)", "min"),
        ("Abs Rel", "min"),
        ("RMSE (m)", "min"),
        ("δ<1.25", "max"),
    ]
    titles = [
        ("loop", ""),
        ("tracked", ""),
        *low,
        ("fps", ""),
        ("baseline", ""),
        ("samples", ""),
        ("held-out loss", ""),
    ]
    table = Table("Loops", [Column(t, b) for t, b in titles])
    loops = [*(summary.get("baselines") or []), *(summary.get("loops") or [])]
    for loop in loops:
        depth, training = loop.get("depth") or {}, loop.get("training") or {}
        learnt = [name for name in loop.get("pose") or {} if name not in test]
        frames = sum_pose(loop, "frames")
        baselines = [float(v) for v in (loop.get("baseline") or {}).values() if v]  # monocular SLAM has none
        before, after = training.get("held_out_before"), training.get("held_out_after")
        table.rows.append(
            [
                f"{loop.get('loop', '')} {loop_name(loop)}".strip(),
                f"{sum_pose(loop, 'tracked_frames') or 0}/{frames}" if frames else None,
                mean_pose(loop, "ate_rmse", learnt),
                mean_pose(loop, "ate_rmse", test),
                mean_pose(loop, "rpe_translation", learnt),
                mean_pose(loop, "rpe_translation", test),
                depth.get("abs_rel"),
                depth.get("rmse"),
                depth.get("a1"),
                mean_pose(loop, "fps"),
                sum(baselines) / len(baselines) if baselines else None,
                training.get("samples"),
                f"{number(before)} → {number(after)}" if before is not None and after is not None else None,
            ]
        )
    table.note = _loops_note(loops, test)
    return table.without_empty_columns()


def _loops_note(loops: list[dict[str, Any]], test: list[str]) -> str:
    kinds = {p.get("alignment") for loop in loops for p in (loop.get("pose") or {}).values() if p.get("pairs")}
    names = {n for loop in loops for n in (loop.get("pose") or {})}
    parts = []
    if kinds:
        words = " and ".join(ALIGNMENT_WORDS.get(str(k), str(k)) for k in sorted(kinds, key=str))
        learnt = len(names - set(test))
        means = f", means of {len(names)} sequences" if len(names) > 1 else ""
        if test:
            means = f", means of {learnt} training and {len(names) - learnt} test sequences"
        parts.append(f"Pose errors after {words}{means}.")
    depth = next((loop["depth"] for loop in reversed(loops) if (loop.get("depth") or {}).get("images")), None)
    if depth:
        parts.append(f"Depth errors: {depth_basis(depth).removeprefix('Abs Rel, ')}.")
    if any((loop.get("training") or {}).get("held_out_after") is not None for loop in loops):
        parts.append("Held-out loss: label-free, before → after training.")
    return " ".join(parts)


def pose_table(summary: dict[str, Any]) -> Table:
    """Return every pose figure by sequence and loop, with the paper's where it has the sequence."""
    figures = [
        ("ate_rmse", "ATE RMSE (m)"),
        ("ate_median", "median (m)"),
        ("ate_max", "max (m)"),
        ("rpe_translation", "RPE (m)"),
        ("rpe_rotation_deg", "RPE (°)"),
        ("kitti_translation_percent", "Rel Tr (%)"),
        ("kitti_rotation_deg_per_m", "Rel Rot (°/m)"),
    ]
    counts = [("scale", "scale"), ("pairs", "pairs"), ("keyframes", "keyframes"), ("points", "points"), ("fps", "fps")]
    columns = [Column("sequence, loop"), Column("tracked"), *(Column(t, "min") for _, t in figures)]
    table = Table("Pose by sequence", [*columns, *(Column(t) for _, t in counts)])
    loops = [*(summary.get("baselines") or []), *(summary.get("loops") or [])]
    names = list(dict.fromkeys(n for loop in loops for n in (loop.get("pose") or {})))
    for name in names:
        ours = len(table.rows)
        for loop in loops:
            pose = (loop.get("pose") or {}).get(name)
            if pose is not None:
                tracked = f"{pose.get('tracked_frames', 0)}/{pose.get('frames', 0)}"
                cells = [_plain(pose.get(key)) for key, _ in figures + counts]
                table.rows.append([f"{name}, {loop_name(loop)}", tracked, *cells])
        # Different sequences do not compete with each other, so only a single one gets its best figures emphasised.
        table.contenders = len(table.rows) - ours if len(names) == 1 else 0
        for system, (ate, translation, rotation) in published_pose(summary.get("data"), name).items():
            tail: list[Cell] = [None, None, None, None, translation, rotation, *[None] * len(counts)]
            table.rows.append([f"{name}, {system} (paper)", "failed" if ate is None else None, ate, *tail])
    table.note = "ATE: absolute trajectory error after alignment. RPE: error from one frame to the next."
    shown = table.without_empty_columns()
    if any(column.title.startswith("Rel Tr") for column in shown.columns):
        shown.note += " Rel Tr and Rel Rot: KITTI odometry benchmark over 100–800 m."
    return shown


def depth_table(summary: dict[str, Any]) -> Table:
    """Return the seven depth metrics by loop, with the paper's where they exist for the data."""
    keys = list(DEPTH_TITLES)
    columns = [Column(DEPTH_TITLES[k], "max" if k in HIGHER_IS_BETTER else "min") for k in keys]
    extra = [Column("images"), Column("scale"), Column("scale spread")]
    table = Table("Depth", [Column("loop"), *columns, *extra])
    for loop in summary.get("loops") or []:
        depth = loop.get("depth") or {}
        if depth.get("images"):
            tail = [_plain(depth.get(k)) for k in ("images", "scale_median", "scale_std")]
            table.rows.append([loop_name(loop), *[_plain(depth.get(k)) for k in keys], *tail])
            table.note = f"Means over images: {depth_basis(depth).removeprefix('Abs Rel, ')}."
    table.contenders = len(table.rows)
    published = published_depth(summary) if table.rows else None
    if published:
        table.rows += [[f"{n} (paper)", *values, None, None, None] for n, values in published[1].items()]
        same = all((loop.get("depth") or {}).get("images") in (None, EIGEN_IMAGES) for loop in summary["loops"])
        alike = same and summary.get("data") == "kitti_raw"
        other = "as many as here" if alike else "another set of images, so compare the trend"
        table.note += f" Paper: {published[0]}, 80 m cap; {other}."
    return table.without_empty_columns()


def _plain(value: Any) -> Cell:
    return value if isinstance(value, str | int | float) and not isinstance(value, bool) else None


def print_summary(summary: dict[str, Any], console: Console) -> None:
    """Print the tables of a run and its summary in words."""
    from rich.padding import Padding
    from rich.text import Text

    makers: tuple[Callable[[dict[str, Any]], Table], ...] = (loops_table, depth_table)
    if len({n for loop in summary.get("loops") or [] for n in (loop.get("pose") or {})}) > 1:
        makers = (loops_table, pose_table, depth_table)
    for make in makers:
        table = make(summary)
        if table.rows:
            console.print(to_rich(table))
    for sentence in describe(summary):
        console.print(Padding(Text(sentence), (0, 1)))


def metrics_rows(summary: dict[str, Any]) -> list[list[Cell]]:
    """Return every figure of a summary as ``[loop, name, kind, sequence, metric, value]``."""
    rows: list[list[Cell]] = []
    for loop in [*(summary.get("baselines") or []), *(summary.get("loops") or [])]:
        head: list[Cell] = [int(loop["loop"]) if "loop" in loop else None, loop_name(loop)]
        for sequence, figures in (loop.get("pose") or {}).items():
            rows += [[*head, "pose", sequence, k, _text(v)] for k, v in figures.items() if v is not None]
        for kind in ("depth", "training"):
            rows += [[*head, kind, "", k, _text(v)] for k, v in (loop.get(kind) or {}).items() if _fits(v)]
        for row in (loop.get("depth") or {}).get("by_cap") or []:
            rows += [[*head, "depth", "", f"{k}@{row['cap']:g}m", row.get(k)] for k in DEPTH_TITLES]
        for kind in ("baseline", "depth_max"):
            rows += [[*head, "sensing", s, kind, v] for s, v in (loop.get(kind) or {}).items() if v is not None]
    return rows


def _fits(value: Any) -> bool:
    return value is not None and not (isinstance(value, list) and value and isinstance(value[0], dict))


def _text(value: Any) -> Cell:
    if not isinstance(value, list | tuple):
        return value
    if any(isinstance(v, str) for v in value):  # sentences, such as what speaks against a trajectory
        return "; ".join(map(str, value))
    return " ".join(f"{v:g}" for v in value)


def write_metrics_csv(summary: dict[str, Any], path: Path | str) -> None:
    """Write every figure of a summary as a long table: ``loop,name,kind,sequence,metric,value``."""
    columns = [Column(c) for c in ("loop", "name", "kind", "sequence", "metric", "value")]
    with atomic_path(path) as temporary:
        temporary.write_text(to_csv(Table("metrics", columns, metrics_rows(summary))), encoding="utf-8")
