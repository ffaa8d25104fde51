"""``python -m prgbd.plugins``: what is installed and where it comes from; ``check ID`` tests one thoroughly.

Listing imports nothing. A check makes the plug-in with its defaults, or with the options that follow its id.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from prgbd.core.errors import ConfigError, PrgbdError, UnknownPluginError
from prgbd.core.registry import KINDS, REGISTRY, PluginSpec, specs

TITLES = {
    "depth": "Depth estimators",
    "slam": "SLAM systems",
    "data": "Data",
    "loss": "Loss terms",
    "criterion": "Criteria",
    "augmentation": "Augmentations",
}


def main(argv: list[str] | None = None) -> int:
    """List the plug-ins, or check one.

    Args:
        argv: Arguments; ``sys.argv`` when None.

    Returns:
        The exit code: 0, 1 where a check fails, 2 where there is nothing to check.
    """
    parser = argparse.ArgumentParser(prog="python -m prgbd.plugins", description=__doc__)
    parser.add_argument("what", nargs="?", choices=(*KINDS, "check"), help="list this kind alone, or check a plug-in")
    parser.add_argument("id", nargs="?", help="of the plug-in to check; depth:ID where several kinds have the id")
    parser.add_argument("options", nargs="*", metavar="OPTION=VALUE", help="of the plug-in to check")
    arguments = parser.parse_args(argv)
    console = Console() if sys.stdout.isatty() else Console(width=200, color_system=None)
    if arguments.what != "check":
        if arguments.id:
            parser.error(f"unknown argument '{arguments.id}'; to check a plug-in write: check {arguments.id}")
        _list(console, KINDS if arguments.what is None else (arguments.what,))
        return 0
    if not arguments.id:
        parser.error("check needs the id of a plug-in")
    try:
        return _check(console, find(arguments.id), parse_options(arguments.options))
    except PrgbdError as error:
        print(f"prgbd: {error}", file=sys.stderr)
        return 2


def find(plugin_id: str) -> PluginSpec:
    """Find a plug-in by ``ID`` or ``KIND:ID`` in whatever kind it is.

    Raises:
        UnknownPluginError: With the nearest ids of all kinds.
        ConfigError: If several kinds have it.
    """
    kind, _, name = plugin_id.rpartition(":")
    if kind:
        return REGISTRY.resolve(kind, name)
    found, complaints = [], []
    for kind in KINDS:
        try:
            found.append(REGISTRY.resolve(kind, name))
        except UnknownPluginError as error:
            complaints.append(str(error))
    if len(found) > 1:
        listed = " or ".join(f"{spec.kind}:{name}" for spec in found)
        raise ConfigError(f"'{name}' is the id of several plug-ins; write {listed}.")
    if found:
        return found[0]
    near = [complaint for complaint in complaints if "did you mean" in complaint]
    raise UnknownPluginError(near[0] if near else f"There is no plug-in '{name}'; python -m prgbd.plugins lists them.")


def parse_options(words: list[str]) -> dict[str, Any]:
    """Read ``option=value`` words; values are YAML, as on prgbd's command line.

    Raises:
        ConfigError: If a word is none.
    """
    import yaml  # type: ignore[import-untyped]

    options = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals):
            raise ConfigError(f"'{word}' is not understood; write option=value.")
        options[name] = yaml.safe_load(value)
    return options


def _list(console: Console, kinds: tuple[str, ...]) -> None:
    for kind in kinds:
        table = Table(title=TITLES[kind], title_justify="left", box=None, pad_edge=False, header_style="dim")
        table.add_column("id", style="bold", no_wrap=True)
        table.add_column("what it is")
        table.add_column("from", no_wrap=True)
        table.add_column("extra", no_wrap=True)
        for spec in sorted(specs(kind), key=lambda s: (s.origin != "built-in", s.id)):
            table.add_row(spec.id, escape(spec.description), escape(spec.origin), escape(_extra(spec)))
        console.print(table)
        for sentence in REGISTRY.shadowed(kind):
            console.print(sentence, style="yellow", markup=False, highlight=False)
        console.print()
    console.print("Use one with  python -m prgbd slam=ID depth=ID data=ID", style="dim")
    console.print("    and  loss.ID.weight=1 task.criterion=ID augmentation.ID.probability=0.5", style="dim")
    console.print("Check one with  python -m prgbd.plugins check ID [OPTION=VALUE ...]", style="dim", markup=False)


def _extra(spec: PluginSpec) -> str:
    if not spec.extra:
        return ""
    return f"pip install 'prgbd[{spec.extra}]'" if spec.missing else f"{spec.extra}, installed"


def _check(console: Console, spec: PluginSpec, options: dict[str, Any]) -> int:
    """Run every check of a plug-in and print a line for each."""
    from prgbd.core.testing.conformance import checks_of

    console.print(f"{spec.kind} {spec.id} ({spec.origin})", style="bold", markup=False)
    if spec.kind == "data" and "sequence" not in options:
        sequence = REGISTRY.make_sequences(spec.id, checks=False, **options)[0]
        checks = checks_of("data", sequence)
    else:
        checks = checks_of(spec.kind, REGISTRY.make(spec.kind, spec.id, checks=False, **options))
    failed = 0
    for check in checks:
        try:
            check.run()
        except PrgbdError as error:
            complaint = str(error)
        except (Exception, SystemExit) as error:  # a plug-in may raise anything; the other checks still tell something
            complaint = f"raised {type(error).__name__}: {error}"
        else:
            console.print(f"  [green]ok[/green]    {escape(check.title)}", highlight=False)
            continue
        failed += 1
        console.print(f"  [red]FAILS[/red] {escape(check.title)}\n        {escape(complaint)}", highlight=False)
    if failed:
        console.print(f"{failed} of {len(checks)} checks failed.")
        return 1
    console.print(f"All {len(checks)} checks passed.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
