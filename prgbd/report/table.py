"""A table of figures that stay numbers until they are rendered, and which of them are the best."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pandas as pd

from prgbd.core.errors import ConfigError
from prgbd.report import depth_metrics
from prgbd.report.words import number

Cell = str | float | int | None
Marked = tuple[str, bool]
"""The text of a cell and whether it is the best of its column."""


class Spread(float):
    """A mean that knows the standard deviation of what it was taken over; it sorts and computes as the mean."""

    def __new__(cls, mean: float, deviation: float) -> Spread:
        """Make one from a mean and a standard deviation."""
        made = super().__new__(cls, mean)
        made.deviation = deviation
        return made

    deviation: float


@dataclass(frozen=True)
class Table:
    """A data frame with what it takes to be printed.

    Attributes:
        title: What the table shows.
        frame: One row per run, loop or recording, named by the first column; cells are words, numbers, ``Spread`` or
            None. Headings have their unit in brackets.
        best: Which way is better, ``min`` or ``max``, for the columns whose best figure is emphasised.
        note: What the figures rest on.
        contenders: How many of the first rows compete for the emphasis (all by default; published rows do not).
    """

    title: str
    frame: pd.DataFrame
    best: Mapping[str, str] = field(default_factory=dict)
    note: str = ""
    contenders: int | None = None

    @classmethod
    def of(cls, title: str, rows: Sequence[Mapping[str, Any]], **options: Any) -> Table:
        """Make a table of rows ``{heading: cell}``; columns with nothing in any row are left out."""
        frame = pd.DataFrame(list(rows), dtype=object).dropna(axis=1, how="all")
        return cls(title, frame.where(frame.notna(), None), **options)

    @property
    def titles(self) -> list[str]:
        """The headings."""
        return list(self.frame)

    @property
    def rows(self) -> list[dict[str, Cell]]:
        """The rows as ``{heading: cell}``."""
        return [dict(zip(self.frame, row, strict=True)) for row in self.frame.itertuples(index=False, name=None)]

    def marks(self, column: str) -> list[bool]:
        """Return which cells of a column are the best.

        The best is the best unrounded figure. Figures that print the same as it are marked with it, since a reader sees
        no difference, and nothing is marked where all print the same.
        """
        cells = self.frame[column].tolist()
        known = [c for c in cells[: self.contenders] if isinstance(c, int | float)]
        shown = [number(float(c)) for c in known]
        if column not in self.best or len(set(shown)) < 2:
            return [False] * len(cells)
        best = number(float(min(known) if self.best[column] == "min" else max(known)))
        marked = [isinstance(c, int | float) and number(float(c)) == best for c in cells[: self.contenders]]
        return marked + [False] * (len(cells) - len(marked))

    def cells(self) -> list[list[Marked]]:
        """Return the rows as texts, each with whether it is the best of its column."""
        columns = [zip(map(cell_text, self.frame[c]), self.marks(c), strict=True) for c in self.frame]
        return [list(row) for row in zip(*columns, strict=True)]


def column_key(heading: str) -> str:
    """Return the name by which a column is chosen: ``ATE last (m)`` -> ``ate_last``, ``δ<1.25`` -> ``a1``."""
    for key, title in reversed(depth_metrics.TITLES.items()):
        heading = heading.replace(title, key) if title.startswith("δ") else heading
    return "_".join(re.findall(r"\w+", re.sub(r"\(.*?\)", "", heading).lower()))


def choose_columns(tables: Sequence[Table], names: Sequence[str]) -> list[Table]:
    """Return the tables with their first column and those whose ``column_key`` is named, in the order of the names.

    A table that has none of them is left out. Without names all stays as it is.

    Raises:
        ConfigError: If a name fits no column of any table.
    """
    if not names:
        return list(tables)
    known = [column_key(title) for table in tables for title in table.titles[1:]]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ConfigError(f"There is no column '{unknown[0]}'; choose from {', '.join(dict.fromkeys(known))}.")
    chosen = [(t, [title for name in names for title in t.titles[1:] if column_key(title) == name]) for t in tables]
    return [replace(table, frame=table.frame[[table.titles[0], *titles]]) for table, titles in chosen if titles]


def cell_text(cell: Cell) -> str:
    """Render a cell: words as they are, counts in full, figures with three significant digits, a dash for None."""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Spread):
        return f"{number(cell)} ± {number(cell.deviation)}"
    return f"{cell:,}" if isinstance(cell, int) else number(cell)
