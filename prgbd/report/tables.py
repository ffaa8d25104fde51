"""The tables of a run: its loops, its poses by sequence, its depth, and every figure as CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from prgbd.io.files import atomic_path
from prgbd.report import depth_metrics
from prgbd.report.paper import published_depth, published_pose
from prgbd.report.reading import entries, loop_name, mean_pose, sum_pose
from prgbd.report.rendering import to_rich
from prgbd.report.table import Cell, Table, choose_columns
from prgbd.report.words import ALIGNMENT_WORDS, depth_basis, describe, number

if TYPE_CHECKING:
    from rich.console import Console

EIGEN_IMAGES = 697  # test images of the Eigen split
_LOWEST = ("ATE RMSE (m)", "ATE, test (m)", "RPE (m)", "RPE, test (m)", "Abs Rel", "RMSE (m)")
_POSE_ERRORS = {
    "ate_rmse": "ATE RMSE (m)",
    "ate_median": "median (m)",
    "ate_max": "max (m)",
    "rpe_translation": "RPE (m)",
    "rpe_rotation_deg": "RPE (°)",
    "kitti_translation_percent": "Rel Tr (%)",
    "kitti_rotation_deg_per_m": "Rel Rot (°/m)",
}
_POSE_COUNTS = ("scale", "pairs", "keyframes", "points", "fps")


def loops_table(summary: dict[str, Any]) -> Table:
    """Return the table of a run's baselines and loops: what each reached and what it learned from.

    Figures are means over sequences; those of training and of test sequences stand apart where a run has both.
    """
    test = [str(name) for name in summary.get("test_sequences") or []]
    loops = entries(summary)
    best = dict.fromkeys(_LOWEST, "min") | {"δ<1.25": "max"}
    return Table.of("Loops", [_loop_row(loop, test) for loop in loops], best=best, note=_loops_note(loops, test))


def _loop_row(loop: dict[str, Any], test: list[str]) -> dict[str, Cell]:
    depth, training = loop.get("depth") or {}, loop.get("training") or {}
    learnt = [name for name in loop.get("pose") or {} if name not in test]
    frames = sum_pose(loop, "frames")
    baselines = [float(v) for v in (loop.get("baseline") or {}).values() if v]  # monocular SLAM has none
    before, after = training.get("held_out_before"), training.get("held_out_after")
    return {
        "loop": f"{loop.get('loop', '')} {loop_name(loop)}".strip(),
        "tracked": f"{sum_pose(loop, 'tracked_frames') or 0}/{frames}" if frames else None,
        "ATE RMSE (m)": mean_pose(loop, "ate_rmse", learnt),
        "ATE, test (m)": mean_pose(loop, "ate_rmse", test),
        "RPE (m)": mean_pose(loop, "rpe_translation", learnt),
        "RPE, test (m)": mean_pose(loop, "rpe_translation", test),
        "Abs Rel": depth.get("abs_rel"),
        "RMSE (m)": depth.get("rmse"),
        "δ<1.25": depth.get("a1"),
        "fps": mean_pose(loop, "fps"),
        "baseline": sum(baselines) / len(baselines) if baselines else None,
        "samples": training.get("samples"),
        "held-out loss": f"{number(before)} → {number(after)}" if None not in (before, after) else None,
    }


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
    loops = entries(summary)
    names = list(dict.fromkeys(n for loop in loops for n in (loop.get("pose") or {})))
    rows: list[dict[str, Cell]] = []
    contenders = 0
    for name in names:
        rows += [_pose_row(name, loop) for loop in loops if (loop.get("pose") or {}).get(name) is not None]
        # Different sequences do not compete with each other, so only a single one gets its best figures emphasised.
        contenders = len(rows) if len(names) == 1 else 0
        for system, (ate, translation, rotation) in published_pose(summary.get("data"), name).items():
            paper = {"ATE RMSE (m)": ate, "Rel Tr (%)": translation, "Rel Rot (°/m)": rotation}
            tracked = "failed" if ate is None else None
            rows.append({"sequence, loop": f"{name}, {system} (paper)", "tracked": tracked, **paper})
    note = "ATE: absolute trajectory error after alignment. RPE: error from one frame to the next."
    if any(row.get("Rel Tr (%)") is not None for row in rows):
        note += " Rel Tr and Rel Rot: KITTI odometry benchmark over 100–800 m."
    best = dict.fromkeys(_POSE_ERRORS.values(), "min")
    return Table.of("Pose by sequence", rows, best=best, note=note, contenders=contenders)


def _pose_row(name: str, loop: dict[str, Any]) -> dict[str, Cell]:
    pose = loop["pose"][name]
    return {
        "sequence, loop": f"{name}, {loop_name(loop)}",
        "tracked": f"{pose.get('tracked_frames', 0)}/{pose.get('frames', 0)}",
        **{title: pose.get(key) for key, title in _POSE_ERRORS.items()},
        **{key: pose.get(key) for key in _POSE_COUNTS},
    }


def depth_table(summary: dict[str, Any]) -> Table:
    """Return the seven depth metrics by loop, with the paper's where they exist for the data."""
    loops = summary.get("loops") or []
    measured = [(loop, loop["depth"]) for loop in loops if (loop.get("depth") or {}).get("images")]
    rows: list[dict[str, Cell]] = [
        {
            "loop": loop_name(loop),
            **{title: depth.get(key) for key, title in depth_metrics.TITLES.items()},
            "images": depth["images"],
            "scale": depth.get("scale_median"),
            "scale spread": depth.get("scale_std"),
        }
        for loop, depth in measured
    ]
    note = f"Means over images: {depth_basis(measured[-1][1]).removeprefix('Abs Rel, ')}." if measured else ""
    published = published_depth(summary) if measured else None
    if published:
        titles = depth_metrics.TITLES.values()
        rows += [{"loop": f"{n} (paper)", **dict(zip(titles, v, strict=True))} for n, v in published[1].items()]
        alike = summary.get("data") == "kitti_raw" and all(depth.get("images") == EIGEN_IMAGES for _, depth in measured)
        other = "as many as here" if alike else "another set of images, so compare the trend"
        note += f" Paper: {published[0]}, 80 m cap; {other}."
    return Table.of("Depth", rows, best=depth_metrics.BEST, note=note, contenders=len(measured))


def run_tables(summary: dict[str, Any]) -> list[Table]:
    """Return the tables of a run that have anything to show; poses by sequence only where there are several."""
    makers: tuple[Callable[[dict[str, Any]], Table], ...] = (loops_table, depth_table)
    if len({n for loop in summary.get("loops") or [] for n in (loop.get("pose") or {})}) > 1:
        makers = (loops_table, pose_table, depth_table)
    return [table for table in (make(summary) for make in makers) if not table.frame.empty]


def print_summary(summary: dict[str, Any], console: Console, columns: Sequence[str] = ()) -> None:
    """Print the tables of a run, with all or with the named columns, and its summary in words."""
    from rich.padding import Padding
    from rich.text import Text

    for table in choose_columns(run_tables(summary), columns):
        console.print(to_rich(table))
    for sentence in describe(summary):
        console.print(Padding(Text(sentence), (0, 1)))


def metrics_rows(summary: dict[str, Any]) -> list[list[Cell]]:
    """Return every figure of a summary as ``[loop, name, kind, sequence, metric, value]``."""
    rows: list[list[Cell]] = []
    for loop in entries(summary):
        head: list[Cell] = [int(loop["loop"]) if "loop" in loop else None, loop_name(loop)]
        for sequence, figures in (loop.get("pose") or {}).items():
            rows += [[*head, "pose", sequence, k, _text(v)] for k, v in figures.items() if v is not None]
        for kind in ("depth", "training"):
            rows += [[*head, kind, "", k, _text(v)] for k, v in (loop.get(kind) or {}).items() if _fits(v)]
        for row in (loop.get("depth") or {}).get("by_cap") or []:
            rows += [[*head, "depth", "", f"{k}@{row['cap']:g}m", row.get(k)] for k in depth_metrics.TITLES]
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
    columns = ["loop", "name", "kind", "sequence", "metric", "value"]
    with atomic_path(path) as temporary:
        pd.DataFrame(metrics_rows(summary), columns=columns, dtype=object).to_csv(
            temporary, index=False, lineterminator="\n"
        )
