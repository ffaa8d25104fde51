"""``python -m prgbd --help training``: what the options of a group mean, from the docstrings of their dataclasses."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from prgbd.cli.hydra_bridge import OWN_GROUPS, options_class
from prgbd.cli.options import CommonOptions
from prgbd.cli.plugin_choices import CHOICES, LOOP_KEYS
from prgbd.cli.task_options import TASKS
from prgbd.core.errors import PrgbdError
from prgbd.core.option_errors import dotted, unknown_option
from prgbd.core.registry import KINDS, REGISTRY, SHORT_FOR

_ATTRIBUTES = re.compile(r"^Attributes:\n((?:[ ]{4}.*\n?|\n)+)", re.MULTILINE)
_ARGUMENTS = re.compile(_ATTRIBUTES.pattern.replace("Attributes", "Args"), re.MULTILINE)
_ATTRIBUTE = re.compile(r"^[ ]{4}(\w+): (.*(?:\n[ ]{5,}.*)*)", re.MULTILINE)


def print_option_help(console: Console, name: str) -> None:
    """Print the options of a group, or one option, with defaults and meanings.

    Args:
        console: Where to.
        name: Dotted name of a group (``training``, ``slam.tracking``) or of an option (``training.epochs``).

    Raises:
        ConfigError: If there is neither.
    """
    rows = [*_all_rows(), *_plugin_rows(name.partition(".")[0])]
    chosen = [row for row in rows if f"{row[1]}.".startswith(f"{name}.")]
    if not chosen:
        raise unknown_option(name, [key for _, key, _, _ in rows])
    for title in dict.fromkeys(row[0] for row in chosen):
        table = Table(title=title, title_justify="left", box=None, pad_edge=False, show_header=False)
        table.add_column(style="bold", overflow="fold")
        table.add_column()
        for _, key, default, meaning in (row for row in chosen if row[0] == title):
            table.add_row(Text(f"{key}={default}"), Text(meaning))
        console.print(table)
        console.print()


def attribute_docs(cls: type[Any], section: re.Pattern[str] = _ATTRIBUTES) -> dict[str, str]:
    """Return what the docstring of a class, and those that it derives from, say of its fields or arguments."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        text = section.search(inspect.cleandoc(base.__doc__ or ""))
        if text:
            found |= {name: " ".join(said.replace("``", "").split()) for name, said in _ATTRIBUTE.findall(text[1])}
    return found


def _all_rows() -> Iterator[tuple[str, str, str, str]]:
    """Yield (title, dotted name, default, meaning) of every option."""
    yield from (row for row in _rows(CommonOptions(), "", "Options") if row[1] not in OWN_GROUPS)
    for task in TASKS.values():
        yield from _rows(task(), "task", f"task={task.name}")
    for kind, choice in CHOICES.items():
        yield from _rows(choice(), kind, f"Every {kind}=", LOOP_KEYS[kind])
        for spec in REGISTRY.specs(kind):
            if (options := options_class(spec)) is not None:
                yield from _rows(options(), kind, f"{kind}={spec.id}")


def _plugin_rows(kind: str) -> Iterator[tuple[str, str, str, str]]:
    """Yield the same of the plug-ins of a kind whose constructor tells their options; those that break are left out."""
    for spec in REGISTRY.specs(kind) if kind in KINDS else ():
        if spec.options:
            continue
        try:
            options = REGISTRY.options(kind, spec.id)
            docs = attribute_docs(REGISTRY.load(spec), _ARGUMENTS)
        except PrgbdError:
            continue
        prefix = f"{kind}.{spec.id}" if kind in SHORT_FOR else kind
        title = spec.description if kind in SHORT_FOR else f"{kind}={spec.id}"
        for name, option in options.items():
            default = "" if option.default is option.empty else _written(option.default)
            yield title, f"{prefix}.{name}", default, docs.get(name, "")


def _rows(
    options: Any, prefix: str, title: str, names: tuple[str, ...] | None = None
) -> Iterator[tuple[str, str, str, str]]:
    docs = attribute_docs(type(options))
    for option in fields(options):
        key, value = dotted(prefix, option.name), getattr(options, option.name)
        if is_dataclass(value):
            yield from _rows(value, key, docs.get(option.name, title) if not prefix else title)
        elif names is None or option.name in names:
            yield title, key, _written(value), docs.get(option.name, "")


def _written(value: Any) -> str:
    """Return a value as it is written on the command line."""
    if isinstance(value, list | tuple):
        return f"[{','.join(_written(item) for item in value)}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(value)
