"""Tables as Markdown, CSV, LaTeX, and on the terminal; ``templates/parts.html`` has them as HTML."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from prgbd.io.files import atomic_path
from prgbd.report.table import Marked, Spread, Table
from prgbd.report.templates import render

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.table import Table as RichTable

# What fits a page of LaTeX's article class in footnotesize: characters across, each column taking a gap, and rows.
LATEX_WIDTH, LATEX_GAP, LATEX_ROWS = 80, 2, 40


def to_markdown(table: Table) -> str:
    """Render as a Markdown table with its note below."""
    return render("table.md", table=table)


def to_csv(table: Table) -> str:
    """Render as CSV with figures in full precision, empty cells for None, and deviations in columns of their own."""
    frame = table.frame.copy()
    for title in table.frame:
        if any(isinstance(cell, Spread) for cell in frame[title]):
            deviations = [getattr(cell, "deviation", None) for cell in frame[title]]
            frame.insert(frame.columns.get_loc(title) + 1, f"{title} std", deviations)
    return frame.to_csv(index=False, lineterminator="\n")


def to_latex(table: Table) -> str:
    """Render as LaTeX tables with booktabs rules that fit a page: upright or turned, whatever takes fewer of them."""
    lines = _lines(table)
    return render("table.tex", table=table, parts=min(_pages(lines), _pages(_turned(lines)), key=len))


@dataclass(frozen=True)
class _Page:
    """The part of a table that fits a page; ``wide`` if two columns alone do not, and must be made smaller."""

    head: list[Marked]
    rows: list[list[Marked]]
    wide: bool


def _pages(lines: list[list[Marked]]) -> list[_Page]:
    """Split a table into parts that fit a page, each with the first column."""
    widths = [max(len(text) for text, _ in column) + LATEX_GAP for column in _turned(lines)]
    groups: list[list[int]] = [[0]]
    for i in range(1, len(widths)):
        if len(groups[-1]) > 1 and sum(widths[k] for k in [*groups[-1], i]) > LATEX_WIDTH:
            groups.append([0])
        groups[-1].append(i)
    pages = []
    for columns in groups:
        head, *rows = [[line[i] for i in columns] for line in lines]
        wide = sum(widths[i] for i in columns) > LATEX_WIDTH
        pages += [_Page(head, rows[at : at + LATEX_ROWS], wide) for at in range(0, max(len(rows), 1), LATEX_ROWS)]
    return pages


def _lines(table: Table) -> list[list[Marked]]:
    """Return headings and rows as texts."""
    return [[(title, False) for title in table.titles], *table.cells()]


def _turned(lines: list[list[Marked]]) -> list[list[Marked]]:
    """Exchange rows and columns."""
    return [list(column) for column in zip(*lines, strict=True)]


def write_tables(tables: Sequence[Table], folder: Path, name: str) -> list[Path]:
    """Write tables one below the other as ``NAME.md``, ``NAME.csv`` and ``NAME.tex``; return the three paths."""
    paths = [folder / f"{name}.{suffix}" for suffix in ("md", "csv", "tex")]
    for path, as_text in zip(paths, (to_markdown, to_csv, to_latex), strict=True):
        with atomic_path(path) as temporary:
            temporary.write_text("\n".join(as_text(table) for table in tables), encoding="utf-8")
    return paths


@dataclass(frozen=True)
class FittedTable:
    """A table for the terminal that turns on its side where the terminal is too narrow for it."""

    table: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RichTable]:
        from rich.measure import Measurement

        upright, turned = _rich(self.table, _lines(self.table)), _turned(_lines(self.table))
        wanted = Measurement.get(console, options.update_width(10_000), upright).maximum
        yield (upright if wanted <= options.max_width else _rich(self.table, turned))


def to_rich(table: Table) -> FittedTable:
    """Render for the terminal: ``console.print(to_rich(table))``."""
    return FittedTable(table)


def _rich(table: Table, lines: list[list[Marked]]) -> RichTable:
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    out = RichTable(title=table.title, caption=table.note or None, box=box.SIMPLE_HEAD, title_justify="left")
    out.title_style, out.caption_style, out.caption_justify = "bold", "dim", "left"
    for i, (title, _) in enumerate(lines[0]):
        out.add_column(Text(title), justify="right" if i else "left", no_wrap=i == 0, overflow="fold")
    for row in lines[1:]:
        out.add_row(*[Text(text, style="bold green" if best else "") for text, best in row])
    return out
