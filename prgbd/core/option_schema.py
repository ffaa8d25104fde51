"""Dataclasses of options as structured configs, for Hydra's ConfigStore."""

from __future__ import annotations

import copy
import functools
from collections.abc import Collection, Iterable
from dataclasses import MISSING, Field, field, fields, make_dataclass
from typing import Any, get_args, get_origin

from prgbd.core.options import box_of, default_of, field_types, is_group


def schema(cls: type[Any], without: Collection[str] = (), **more: Any) -> type[Any]:
    """Return a dataclass like ``cls`` that OmegaConf takes as a structured config, for Hydra's ConfigStore.

    It has the same names and defaults, no checks of ranges, and is not frozen, for OmegaConf lets nobody change the
    groups of a frozen one. A field whose type OmegaConf does not know takes anything; ``from_mapping`` checks it.

    Args:
        cls: The dataclass.
        without: Dotted names of fields to leave out.
        more: Further fields that take anything, with their defaults.
    """
    hints = field_types(cls, ranges=False)
    described: list[Any] = [
        (option.name, kind, _schema_default(option, kind))
        for option in fields(cls)
        if option.name not in without
        for kind in [_schema_type(hints[option.name], _within(option.name, without))]
    ]
    described += [(name, Any, field(default_factory=functools.partial(copy.copy, v))) for name, v in more.items()]
    return make_dataclass(cls.__name__, described)


def _within(group: str, names: Iterable[str]) -> list[str]:
    return [name.removeprefix(f"{group}.") for name in names if name.startswith(f"{group}.")]


def _schema_type(hint: Any, without: Collection[str]) -> Any:
    """Return the type of a field in a schema."""
    if is_group(hint):
        return schema(hint, without)
    if hint in (int, int | None):
        return hint | float  # so that 3.0 is a whole number there, too
    if any(get_origin(part) is dict for part in get_args(hint)):
        return Any  # OmegaConf 2.3 puts nothing into a mapping that was null
    return Any if box_of(hint) is None else hint


def _schema_default(option: Field[Any], kind: Any) -> Any:
    if option.default is MISSING and option.default_factory is MISSING:
        return "???"
    return field(default_factory=lambda: _mirrored(default_of(option), kind))


def _mirrored(value: Any, kind: Any) -> Any:
    """Return a default of an option as its schema holds it."""
    if not is_group(kind):
        return value
    kinds = field_types(kind, ranges=False)
    return kind(**{o.name: _mirrored(getattr(value, o.name), kinds[o.name]) for o in fields(kind)})
