"""``python -m prgbd.report DIR...``: rebuild the report of a run, or join the runs below a folder into one table."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console

from prgbd.core.errors import PrgbdError
from prgbd.io.command import exit_code
from prgbd.io.disk import unwritable
from prgbd.report import ablation, tables
from prgbd.report.compare import write_comparison
from prgbd.report.labels import is_run
from prgbd.report.page import write_report
from prgbd.report.print_figures import write_figures
from prgbd.report.reading import open_run
from prgbd.report.rendering import to_rich, write_tables
from prgbd.report.table import choose_columns


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit code, see ``ExitCode``."""
    options = _parser().parse_args(arguments)
    return exit_code(lambda: _run(options))


def _run(options: argparse.Namespace) -> int:
    """Report on every folder; one that cannot be read or written does not stop the others."""
    console = Console() if sys.stdout.isatty() else Console(width=200, color_system=None)
    errors = Console(stderr=True)
    code = 0
    for folder in [None] if options.compare else options.folders:
        try:
            if folder is None:
                compared, written = write_comparison(options.folders, options.out, options.columns)
                for table in compared:
                    console.print(to_rich(table))
            else:
                written = report(folder, options.columns, options.figures, console)
            for path in written:
                console.print(str(path), markup=False, highlight=False, soft_wrap=True)
        except (PrgbdError, OSError) as error:
            told = unwritable(error) if isinstance(error, OSError) else error
            if told is None:
                raise
            errors.print(str(told), markup=False, highlight=False, soft_wrap=True)
            code = told.exit_code
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m prgbd.report",
        description="Rebuild report.html and metrics.csv of a run, or join the runs below a folder into one table.",
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="a run, or a folder of runs")
    parser.add_argument("--compare", action="store_true", help="put the runs side by side on one page")
    parser.add_argument("--out", type=Path, default=Path("comparison"), metavar="DIR", help="folder of the comparison")
    parser.add_argument(
        "--columns",
        type=lambda text: [name for name in text.split(",") if name],
        default=[],
        metavar="NAME,NAME",
        help="columns of the tables, such as ate_last,abs_rel; of a run it also writes tables.md, .csv and .tex",
    )
    parser.add_argument(
        "--figures",
        nargs="*",
        metavar="FORMAT",
        help="write the figures of each run for a paper into its folder figures/: pdf, png, svg (pdf and png)",
    )
    return parser


def report(folder: Path, columns: list[str], figures: list[str] | None, console: Console) -> list[Path]:
    """Report on one folder and return the files that were written.

    Args:
        folder: A run, or a folder of runs.
        columns: Names of the columns of the tables; empty for all.
        figures: Formats of the figures to write of a run, empty for the usual ones, None for no figures.
        console: Where tables are printed.

    Raises:
        DataError: If the folder is neither a run nor a folder of runs, or the run has nothing to draw.
        ConfigError: If there is no such column or format.
    """
    if not is_run(folder):
        for table in choose_columns(ablation.ablation_tables(folder), columns):
            console.print(to_rich(table))
        return ablation.join(folder, columns)
    summary = open_run(folder).summary
    written = []
    if columns:
        written = write_tables(choose_columns(tables.run_tables(summary), columns), folder, "tables")
    tables.print_summary(summary, console, columns)
    tables.write_metrics_csv(summary, folder / "metrics.csv")
    return [*written, write_report(folder), *([] if figures is None else write_figures(folder, figures))]


if __name__ == "__main__":
    sys.exit(main())
