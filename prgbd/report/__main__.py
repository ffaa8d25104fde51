"""``python -m prgbd.report DIR...``: rebuild the report of a run, or join the runs below a folder into one table."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from prgbd.core.errors import PrgbdError


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit code (2 for input that cannot work)."""
    parser = argparse.ArgumentParser(
        prog="python -m prgbd.report",
        description="Rebuild report.html and metrics.csv of a run, or join the runs below a folder into one table.",
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="a run, or a folder of runs")
    parser.add_argument("--compare", action="store_true", help="put the runs side by side on one page")
    parser.add_argument("--out", type=Path, default=Path("comparison"), metavar="DIR", help="folder of the comparison")
    parser.add_argument(
        "--figures",
        nargs="*",
        metavar="FORMAT",
        help="write the figures of each run for a paper into its folder figures/: pdf, png, svg (pdf and png)",
    )
    from rich.console import Console

    console = Console() if sys.stdout.isatty() else Console(width=200, color_system=None)
    errors = Console(stderr=True)
    code = 0
    options = parser.parse_args(arguments)
    for folder in [None] if options.compare else options.folders:
        try:
            if folder is None:
                compare(options.folders, options.out, console)
            else:
                report(folder, console)
                if options.figures is not None:
                    draw(folder, options.figures, console)
        except PrgbdError as error:
            errors.print(str(error), markup=False, highlight=False, soft_wrap=True)
            code = 2
    return code


def report(folder: Path, console: object) -> None:
    """Report on one folder.

    Raises:
        DataError: If the folder is neither a run nor a folder of runs.
    """
    from rich.console import Console

    from prgbd.report import ablation, tables
    from prgbd.report.page import write_report
    from prgbd.report.reading import open_run

    assert isinstance(console, Console)
    if (folder / "summary.json").is_file():
        run = open_run(folder)
        tables.print_summary(run.summary, console)
        tables.write_metrics_csv(run.summary, folder / "metrics.csv")
        written = [write_report(folder)]
    else:
        written = list(ablation.join(folder))
        for table in ablation.ablation_tables(folder):
            console.print(tables.to_rich(table))
    for path in written:
        console.print(str(path), markup=False, highlight=False, soft_wrap=True)


def draw(folder: Path, formats: list[str], console: object) -> None:
    """Write the figures of a run as files.

    Raises:
        ConfigError: If a format is unknown.
        DataError: If the folder is no run, or the run has nothing to draw.
    """
    from rich.console import Console

    from prgbd.report.print_figures import write_figures

    assert isinstance(console, Console)
    for path in write_figures(folder, formats):
        console.print(str(path), markup=False, highlight=False, soft_wrap=True)


def compare(folders: list[Path], out: Path, console: object) -> None:
    """Put several runs side by side.

    Raises:
        DataError: If fewer than two finished runs are there.
    """
    from rich.console import Console

    from prgbd.report import tables
    from prgbd.report.compare import write_comparison

    assert isinstance(console, Console)
    written, paths = write_comparison(folders, out)
    for table in written:
        console.print(tables.to_rich(table))
    for path in paths:
        console.print(str(path), markup=False, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
