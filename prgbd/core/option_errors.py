"""What is said of options that do not exist and of values that do not fit, in one sentence with the full name."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Range

_WORDS = {int: "a whole number", float: "a number", bool: "true or false", str: "text", Path: "a file or folder"}
_LONGEST = 200  # characters of a value in a message
_WORDS_OF_SEVERAL = {int: "whole numbers", float: "numbers", bool: "truth values", str: "texts"}


def unknown_option(key: str, known: Iterable[str]) -> ConfigError:
    """Return the error for an option that does not exist; it names the nearest ones by their full dotted names.

    Args:
        key: Dotted name as the user gave it. Initials (``training.lr``), similar letters, and names without their
            group or in another one are understood.
        known: Dotted names of the options that exist.
    """
    names = sorted(known)
    parent, _, leaf = key.rpartition(".")
    siblings = [name for name in names if name.rpartition(".")[0] == parent]
    groups = sorted({name.rpartition(".")[0] for name in names if name.rpartition(".")[0].rpartition(".")[0] == parent})
    elsewhere = [name for name in names if name.rpartition(".")[2] == leaf]
    near = (
        _near(leaf, [*siblings, *groups])
        or elsewhere
        or _near(leaf, names)
        or difflib.get_close_matches(key, names, n=3, cutoff=0.8)
    )
    top = sorted({name.partition(".")[0] for name in names})
    hint = f"did you mean {listed(near)}?" if near else f"there are {listed(siblings or top)}."
    return ConfigError(f"There is no option '{key}'; {hint}")


def refused(key: str, value: Any, annotation: Any) -> ConfigError:
    """Return the error for a value that an option of a type does not take."""
    infinite = annotation is float and isinstance(value, float) and math.isinf(value)
    return ConfigError(f"{key} is {shown(value)}; it must be {wanted(annotation)}{' and finite' if infinite else ''}.")


def shown(value: Any) -> str:
    """Return a value as it is written, cut in the middle where that would fill the screen."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole numbers of more than 4300 digits
        return "a number of thousands of digits"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 4 :]}"


def wanted(annotation: Any) -> str:
    """Say in words which values a type takes: ``a whole number or auto``, ``a list of 2 numbers``."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if annotation is NoneType:
        return "null"
    if origin is Annotated:
        ranges = [part for part in parts[1:] if isinstance(part, Range)]
        return ranges[0].words(wanted(parts[0])) if ranges else wanted(parts[0])
    if origin is Literal:
        return _either([str(part).lower() if isinstance(part, bool) else str(part) for part in parts])
    if origin in (Union, UnionType):
        return _either([wanted(part) for part in sorted(parts, key=lambda part: part is NoneType)])
    if origin in (list, tuple):
        count = f"{len(parts)} " if origin is tuple and Ellipsis not in parts else ""
        return f"a list of {count}{_of_several(parts[0])}"
    if annotation in _WORDS:
        return _WORDS[annotation]
    if origin is dict or is_dataclass(annotation):
        return "a group of options"
    return f"a value of the type {annotation.__name__ if isinstance(annotation, type) else annotation}"


def _of_several(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return wanted(kind)
    if get_origin(kind) is Annotated:
        kind, *notes = get_args(kind)
        ranges = [note for note in notes if isinstance(note, Range)]
        return ranges[0].words(_of_several(kind)) if ranges else _of_several(kind)
    return _WORDS_OF_SEVERAL.get(kind, "values")


def dotted(prefix: str, name: str) -> str:
    """Return the full name of an option of a group."""
    return f"{prefix}.{name}" if prefix else str(name)


def listed(names: Iterable[str]) -> str:
    """Return names in quotes, with commas."""
    return ", ".join(f"'{name}'" for name in names) or "none"


def _near(leaf: str, siblings: list[str]) -> list[str]:
    """Return the options of a group that a name may stand for: by its initials (lr), or by similar letters."""
    leaves = {name.rpartition(".")[2]: name for name in siblings}
    short = [n for last, n in leaves.items() if "_" in last and "".join(w[0] for w in last.split("_") if w) == leaf]
    return short or [leaves[last] for last in difflib.get_close_matches(leaf, leaves, n=3, cutoff=0.6)]


def _either(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
