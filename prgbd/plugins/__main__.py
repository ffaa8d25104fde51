"""``python -m prgbd.plugins``: what is installed, and where it comes from; nothing is imported."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.table import Table

from prgbd.core.registry import KINDS, specs

TITLES = {"depth": "Depth estimators", "slam": "SLAM systems", "data": "Data"}


def main(argv: list[str] | None = None) -> int:
    """Print one table with a line per plug-in.

    Args:
        argv: Arguments; ``sys.argv`` when None.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(prog="python -m prgbd.plugins", description=__doc__)
    parser.add_argument("kind", nargs="?", choices=KINDS, help="list this kind alone")
    chosen = parser.parse_args(argv).kind
    console = Console()
    for kind in KINDS if chosen is None else (chosen,):
        table = Table(title=TITLES[kind], title_justify="left", box=None, pad_edge=False, header_style="dim")
        table.add_column("id", style="bold", no_wrap=True)
        table.add_column("what it is")
        table.add_column("from", no_wrap=True)
        for spec in sorted(specs(kind), key=lambda s: (s.origin != "built-in", s.id)):
            table.add_row(spec.id, spec.description, spec.origin)
        console.print(table)
        console.print()
    console.print("Use one with  python -m prgbd slam=ID depth=ID data=ID", style="dim")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
