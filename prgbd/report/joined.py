"""Rows of a table that differ in one option alone, joined: over seeds, and over recordings."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import pandas as pd

from prgbd.report.table import Cell, Spread, Table
from prgbd.report.words import number

REFERENCES = {"loss=all", "loss=paper"}
_SAME = "0"


def with_joined(table: Table) -> list[Table]:
    """Return the table, and where it has several seeds or recordings, the tables of what they have in common.

    Where seeds were varied a second table has mean and standard deviation over them. Where recordings were varied,
    further ones have the means over these and the differences on each.
    """
    seeds = spread_over_seeds(table)
    means = means_over_recordings(seeds or table)
    differences = paired_differences(seeds or table) if means else None
    joined = [t for t in (seeds, means, differences) if t]
    # A seed or a recording is not better than another, so only the last tables have a best.
    if joined:
        table = replace(table, best={})
    if means and seeds:
        joined[0] = replace(seeds, best={})
    return [table, *joined]


def spread_over_seeds(table: Table) -> Table | None:
    """Return mean ± standard deviation of the rows that differ in ``seed`` alone; None if no rows do.

    Rows of the paper stay below.
    """
    groups = _grouped(table, "seed")
    if groups is None:
        return None
    rows = _joined_rows(groups, _spread)
    published = table.rows[table.contenders :] if table.contenders is not None else []
    return Table.of(
        f"{table.title}, joined over seeds",
        [*rows, *published],
        best=table.best,
        note=f"{table.note} Mean ± standard deviation over the seeds; a figure that one of them lacks is left out.",
        contenders=len(rows),
    )


def means_over_recordings(table: Table) -> Table | None:
    """Return the means of the rows that differ in ``data.sequences`` alone; None if no rows do.

    Only recordings that every label has count, if there are any: means over different recordings do not compare.
    """
    groups = _grouped(table, "data.sequences")
    if groups is None:
        return None
    shared = set.intersection(*(set(group.index.get_level_values(1)) for _, group in groups.groupby(level=0)))
    if shared:
        groups = groups[groups.index.get_level_values(1).isin(shared)]
    which = "recordings that all rows have" if shared else "runs of a row, which are not the same recordings"
    note = f"Means over the {which}; a figure that one of them lacks is left out."
    rows = _joined_rows(groups, _mean)
    return Table.of(f"{table.title}, means over recordings", rows, best=table.best, note=note)


def paired_differences(table: Table) -> Table | None:
    """Return how far the other rows are from the first, or one of ``REFERENCES``, on each recording that both have.

    Recordings differ more from each other than rows do, so the difference of two means says little. The mean of the
    differences, with its standard error, and the number of recordings on which a row is worse say whether it is one:
    ``+0.03 ± 0.01, worse on 4 of 5``.

    Returns:
        One row per other label and one cell per column that has a best direction; None unless at least two labels share
        two recordings.
    """
    groups = _grouped(table, "data.sequences")
    if groups is None:
        return None
    labels = list(dict.fromkeys(groups.index.get_level_values(0)))
    reference = next((label for label in labels if REFERENCES & set(label.split(", "))), labels[0])
    figures = groups[[title for title in groups if title in table.best]].apply(pd.to_numeric, errors="coerce")
    base, rows = figures.loc[reference], []
    for label in labels:
        shared = figures.loc[label].index.intersection(base.index)
        if label != reference and len(shared) > 1:
            differences = figures.loc[label].loc[shared] - base.loc[shared]
            cells = {title: _difference(differences[title], table.best[title]) for title in figures}
            rows.append({groups.index.names[0]: label, **cells})
    telling = [title for title in figures if any(row[title] != _SAME for row in rows)]  # unlike loop 0 of every loss
    if not rows:
        return None
    title = f"{table.title}, differences from {reference} on the same recordings"
    note = "Mean of the differences ± its standard error over the recordings, and on how many the row is worse."
    return Table.of(title, [{k: row[k] for k in [groups.index.names[0], *telling]} for row in rows], note=note)


def _grouped(table: Table, option: str) -> pd.DataFrame | None:
    """Return the rows by their label without ``option``, and by its value; None if no rows differ in it alone."""
    first, *others = table.frame
    frame = table.frame[: table.contenders]
    frame = frame[frame[others[0]].notna()]  # a run that did not finish has nothing to join, and no number of loops
    keys = [_split(str(label), option) for label in frame[first]]
    labels = {label for label, _ in keys}
    if not any(value for _, value in keys) or len(labels) == len(keys):
        return None
    return frame[others].set_axis(pd.MultiIndex.from_tuples(keys, names=[first, option]))


def _split(label: str, option: str) -> tuple[str, str]:
    """Return a label without an option, and the option: ``loss=all, seed=1`` -> ``loss=all`` and ``seed=1``."""
    parts = re.split(r", (?=[\w.+]+=)", label)
    kept = [part for part in parts if not part.startswith(f"{option}=")]
    return ", ".join(kept) or "all runs", ", ".join(part for part in parts if part not in kept)


def _joined_rows(groups: pd.DataFrame, join: Callable[[list[Cell]], Cell]) -> list[dict[str, Cell]]:
    """Return a row for each label, with the number of its runs."""
    name = groups.index.names[0]
    return [
        {name: label, "runs": len(group)} | {title: join(group[title].tolist()) for title in group}
        for label, group in groups.groupby(level=0, sort=False)
    ]


def _mean(cells: list[Cell]) -> Cell:
    numbers = [float(cell) for cell in cells if isinstance(cell, int | float)]
    return sum(numbers) / len(numbers) if len(numbers) == len(cells) else None


def _spread(cells: list[Cell]) -> Cell:
    """Return what all runs have in common, or the mean of their figures with its standard deviation."""
    if len(set(cells)) == 1:
        return cells[0]
    mean = _mean(cells)
    return None if mean is None else Spread(float(mean), float(pd.Series(cells, dtype=float).std()))


def _difference(differences: pd.Series, best: str) -> Cell:
    if differences.isna().any():
        return None
    if not differences.any():
        return _SAME
    mean, worse = differences.mean(), (differences > 0 if best == "min" else differences < 0).sum()
    sign = "+" if mean >= 0 else "−"
    error = number(differences.sem())
    return f"{sign}{number(abs(mean))} ± {error}, worse on {worse} of {len(differences)}"
