"""The figures that Tiwari et al. (ECCV 2020) published, to be put beside a run on the same data."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib import resources
from typing import Any

import pandas as pd

from prgbd.report.depth_metrics import TITLES

# KITTI Eigen after the first loop: (Sq Rel, RMSE), by the name of the loss configuration.
ABLATION: dict[str, tuple[float, float]] = {
    "paper_no_depth_consistency": (0.958, 4.956),
    "paper_no_depth_transfer": (0.955, 4.867),
    "paper_no_photometric": (0.942, 4.855),
    "paper": (0.931, 4.809),
}


@cache
def _figures(kind: str) -> pd.DataFrame:
    """Return the published figures of ``pose`` (metres, percent, degrees per metre) or of ``depth``."""
    with (resources.files("prgbd.report") / "static" / f"paper_{kind}.csv").open(encoding="utf-8") as file:
        figures = pd.read_csv(file, dtype={"recording": str}).astype(object)
    return figures.where(figures.notna(), None)


def published_pose(data: str | None, sequence: str) -> dict[str, tuple[float | None, float | None, float | None]]:
    """Return the published pose figures of a sequence by system, empty where there are none.

    Each has the ATE RMSE in m (None for a tracking failure), Rel Tr in % and Rel Rot in deg/m.
    """
    figures = _figures("pose")
    figures = figures[figures["data"] == data]
    return {row[2]: row[3:] for row in figures.itertuples(index=False, name=None) if sequence.endswith(row[1])}


def published_depth(summary: dict[str, Any]) -> tuple[str, dict[str, tuple[float, ...]]] | None:
    """Return the published depth figures for the data of a run and the test set they belong to, or None.

    The figures are those of whole test sets, so they are given only for runs that evaluate a part of them.
    """
    data, sequences = summary.get("data"), [str(s) for s in summary.get("sequences") or []]
    figures = _figures("depth")
    rows = list(figures[figures["data"] == data].itertuples(index=False, name=None))
    tested = data == "kitti_raw" or any(published_pose(data, name) for name in sequences)
    return (rows[0][1], {row[2]: row[3:] for row in rows}) if rows and tested else None


def published_refinement(data: str | None, sequences: Iterable[str]) -> dict[str, float]:
    """Return what the paper's loops made of a set of test recordings, beside which a run's first and last loop stand.

    Args:
        data: Id of the data plug-in.
        sequences: The recordings whose mean is compared.

    Returns:
        ``ate_first`` and ``ate_last`` (m, means over the recordings; absent unless each of them is published),
        ``abs_rel_first`` and so on for the pre-trained network, ``abs_rel`` and so on for the refined one.
    """
    out: dict[str, float] = {}
    names = list(sequences)
    for key, system in (("ate_first", "pRGBD-Initial"), ("ate_last", "pRGBD-Refined")):
        errors = [published_pose(data, name).get(system, (None,))[0] for name in names]
        known = [error for error in errors if error is not None]
        if known and len(known) == len(names):
            out[key] = sum(known) / len(known)
    depth = published_depth({"data": data, "sequences": names})
    if depth is not None:
        out |= {f"{metric}_first": value for metric, value in zip(TITLES, depth[1]["MonoDepth2-M"], strict=True)}
        out |= dict(zip(TITLES, depth[1]["pRGBD-Refined"], strict=True))
    return out


def published_ablation(label: str) -> tuple[float, float] | None:
    """Return the published (Sq Rel, RMSE) for an ablation row whose label names a loss configuration, or None."""
    for name, figures in ABLATION.items():
        if any(part.split("=")[-1].strip() == name for part in label.split(",")) and "loss" in label:
            return figures
    return None
