"""One description of a table, rendered for the terminal, Markdown, CSV, LaTeX and HTML."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

from prgbd.report.words import number

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.table import Table as RichTable

Cell = str | float | int | None


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        title: What the heading says, with the unit.
        best: ``min`` or ``max`` to emphasise the best figure, or empty.
    """

    title: str
    best: str = ""


@dataclass
class Table:
    """Rows of cells under columns; numbers stay numbers until they are rendered.

    Attributes:
        title: What the table shows.
        columns: The columns.
        rows: One list of cells per row, as long as ``columns``.
        note: What the figures rest on.
        contenders: How many of the first rows compete for the emphasis (all by default; published rows do not).
    """

    title: str
    columns: list[Column]
    rows: list[list[Cell]] = field(default_factory=list)
    note: str = ""
    contenders: int | None = None

    def best(self, column: int) -> float | None:
        """Return the best figure of a column, None if it has no order, or nothing to choose from."""
        rule = self.columns[column].best
        values = [float(c) for row in self.rows[: self.contenders] if isinstance(c := row[column], int | float)]
        if not rule or len(set(values)) < 2:
            return None
        return min(values) if rule == "min" else max(values)

    def texts(self) -> list[list[tuple[str, bool]]]:
        """Return every cell's text and whether it is the best of its column."""
        best = [self.best(i) for i in range(len(self.columns))]
        contenders = len(self.rows) if self.contenders is None else self.contenders
        return [
            [(cell_text(c), r < contenders and c is not None and c == best[i]) for i, c in enumerate(row)]
            for r, row in enumerate(self.rows)
        ]

    def without_empty_columns(self) -> Table:
        """Return the table without the columns that have nothing in any row."""
        keep = [i for i in range(len(self.columns)) if any(row[i] not in (None, "") for row in self.rows)]
        rows = [[row[i] for i in keep] for row in self.rows]
        return Table(self.title, [self.columns[i] for i in keep], rows, self.note, self.contenders)


def cell_text(cell: Cell) -> str:
    """Render a cell: words as they are, counts in full, figures with three significant digits, a dash for None."""
    if isinstance(cell, str):
        return cell
    return f"{cell:,}" if isinstance(cell, int) else number(cell)


def to_markdown(table: Table) -> str:
    """Render as a Markdown table with its note below."""

    def line(cells: list[str]) -> str:
        return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"

    lines = [f"**{table.title}**", "", line([c.title for c in table.columns])]
    lines.append(line(["---"] + ["---:"] * (len(table.columns) - 1)))
    lines += [line([f"**{t}**" if bold else t for t, bold in row]) for row in table.texts()]
    return "\n".join([*lines, *(["", table.note] if table.note else []), ""])


def to_csv(table: Table) -> str:
    """Render as CSV with the figures in full precision and empty cells for None."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([c.title for c in table.columns])
    writer.writerows([["" if c is None else c for c in row] for row in table.rows])
    return buffer.getvalue()


_LATEX = {"\\": r"\textbackslash{}", "δ": r"$\delta$", "²": "$^2$", "³": "$^3$", "→": r"$\to$", "–": "--", "−": "$-$",
          "<": "$<$", ">": "$>$", "^": r"\^{}", "~": r"\~{}", **{c: "\\" + c for c in "&%$#_{}"}}  # fmt: skip


def to_latex(table: Table) -> str:
    """Render as a LaTeX ``table`` with booktabs rules."""

    def tex(text: str) -> str:
        return "".join(_LATEX.get(c, c) for c in text)

    lines = [
        "% needs \\usepackage{booktabs}",
        "\\begin{table}",
        "  \\centering",
        f"  \\caption{{{tex(table.title)}. {tex(table.note)}}}",
        f"  \\begin{{tabular}}{{l{'r' * (len(table.columns) - 1)}}}",
        "    \\toprule",
        "    " + " & ".join(tex(c.title) for c in table.columns) + r" \\",
        "    \\midrule",
    ]
    for row in table.texts():
        lines.append("    " + " & ".join(f"\\textbf{{{tex(t)}}}" if b else tex(t) for t, b in row) + r" \\")
    return "\n".join([*lines, "    \\bottomrule", "  \\end{tabular}", "\\end{table}", ""])


def to_html(table: Table, caption: bool = True) -> str:
    """Render as an HTML table that scrolls sideways where the screen is narrow, with its title or without."""
    head = "".join(f'<th scope="col">{escape(c.title)}</th>' for c in table.columns)
    body = ""
    for row in table.texts():
        cells = [f"<b>{escape(t)}</b>" if bold else escape(t) for t, bold in row]
        body += f'<tr><th scope="row">{cells[0]}</th>' + "".join(f"<td>{c}</td>" for c in cells[1:]) + "</tr>"
    title = f"<caption>{escape(table.title)}</caption>" if caption else ""
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    return f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{note}'


def transposed(table: Table) -> list[list[tuple[str, bool]]]:
    """Return headings and cells with rows and columns exchanged; the first row holds the names of the rows."""
    texts = table.texts()
    rows = [[(c.title, False), *(row[i] for row in texts)] for i, c in enumerate(table.columns)]
    return rows


@dataclass(frozen=True)
class FittedTable:
    """A table for the terminal that turns on its side where the terminal is too narrow for it."""

    table: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RichTable]:
        from rich.measure import Measurement

        upright = _rich(self.table, [[(c.title, False) for c in self.table.columns], *self.table.texts()])
        wanted = Measurement.get(console, options.update_width(10_000), upright).maximum
        yield upright if wanted <= options.max_width else _rich(self.table, transposed(self.table))


def to_rich(table: Table) -> FittedTable:
    """Render for the terminal: ``console.print(to_rich(table))``."""
    return FittedTable(table)


def _rich(table: Table, lines: list[list[tuple[str, bool]]]) -> RichTable:
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
