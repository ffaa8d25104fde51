"""Rows of an ablation that were run on the same recordings, averaged over them and compared on each."""

from __future__ import annotations

import math
import re

from prgbd.report.rendering import Cell, Column, Table
from prgbd.report.words import number

REFERENCE = "loss=all"
_SAME = "0"


def means_over_recordings(table: Table) -> Table | None:
    """Return the means of the rows that differ in ``data.sequences`` alone; None if no rows do.

    Only recordings that every label has count, if there are any: means over different recordings do not compare.
    """
    groups = _by_recording(table)
    if groups is None:
        return None
    shared = set.intersection(*({world for world, _ in rows} for rows in groups.values()))
    if shared:
        groups = {label: [pair for pair in rows if pair[0] in shared] for label, rows in groups.items()}
    out = Table(f"{table.title}, means over recordings", [table.columns[0], Column("runs"), *table.columns[1:]])
    for label, rows in groups.items():
        cells: list[Cell] = []
        for values in zip(*(row[1:] for _, row in rows), strict=True):
            numbers = [float(v) for v in values if isinstance(v, int | float)]
            cells.append(sum(numbers) / len(numbers) if len(numbers) == len(values) else None)
        out.rows.append([label, len(rows), *cells])
    which = "recordings that all rows have" if shared else "runs of a row, which are not the same recordings"
    out.note = f"Means over the {which}; a figure that one of them lacks is left out."
    return out.without_empty_columns()


def paired_differences(table: Table) -> Table | None:
    """Return how far the other rows are from the first, or from ``loss=all``, on each recording that both have.

    Recordings differ more from each other than rows do, so the difference of two means says little. The mean of the
    differences, with its standard error, and the number of recordings on which a row is worse say whether it is one:
    ``+0.03 ± 0.01, worse on 4 of 5``.

    Returns:
        One row per other label and one cell per column that has a best direction; None unless at least two labels share
        two recordings.
    """
    groups = _by_recording(table)
    if groups is None or len(groups) < 2:
        return None
    reference = next((label for label in groups if REFERENCE in label.split(", ")), next(iter(groups)))
    before = dict(groups[reference])
    judged = [i for i, column in enumerate(table.columns) if column.best]
    columns = [table.columns[0], *(Column(table.columns[i].title) for i in judged)]
    out = Table(f"{table.title}, differences from {reference} on the same recordings", columns)
    for label, rows in groups.items():
        pairs = [(before[world], row) for world, row in rows if world in before]
        if label != reference and len(pairs) > 1:
            out.rows.append([label, *(_difference(pairs, i, table.columns[i].best) for i in judged)])
    if not out.rows:
        return None
    for i in reversed(range(1, len(out.columns))):
        if all(row[i] == _SAME for row in out.rows):  # loop 0 of every loss, for one
            del out.columns[i]
            for row in out.rows:
                del row[i]
    out.note = "Mean of the differences ± its standard error over the recordings, and on how many the row is worse."
    return out.without_empty_columns()


def _by_recording(table: Table) -> dict[str, list[tuple[str, list[Cell]]]] | None:
    """Group rows by their label without ``data.sequences``: label -> recordings with their rows."""
    groups: dict[str, list[tuple[str, list[Cell]]]] = {}
    for row in table.rows[: table.contenders]:
        if row[1] is None:  # a run that did not finish has nothing to average, and no number of loops
            continue
        parts = re.split(r", (?=[\w.+]+=)", str(row[0]))
        kept = [part for part in parts if not part.startswith("data.sequences=")]
        world = ", ".join(part for part in parts if part.startswith("data.sequences="))
        groups.setdefault(", ".join(kept) or "all runs", []).append((world, row))
    runs = sum(map(len, groups.values()))
    varied = any(world for rows in groups.values() for world, _ in rows)
    return groups if varied and len(groups) < runs else None


def _difference(pairs: list[tuple[list[Cell], list[Cell]]], column: int, best: str) -> Cell:
    differences = [
        float(b) - float(a)
        for a, b in ((one[column], other[column]) for one, other in pairs)
        if isinstance(a, int | float) and isinstance(b, int | float)
    ]
    count = len(differences)
    if count < len(pairs):
        return None
    mean = math.fsum(differences) / count
    if not any(differences):
        return _SAME
    error = math.sqrt(math.fsum((d - mean) ** 2 for d in differences) / (count - 1) / count)
    worse = sum(d > 0 if best == "min" else d < 0 for d in differences)
    return f"{'+' if mean >= 0 else '−'}{number(abs(mean))} ± {number(error)}, worse on {worse} of {count}"
