"""Values of options: numbers and settings of dataclasses, checked, with one sentence for what is wrong."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from prgbd.core.errors import ConfigError


def number(config: Mapping[str, Any], key: str, *, optional: bool = False) -> Any:
    """Return a numeric option by its dotted name.

    Raises:
        ConfigError: If it is not a number.
    """
    node: Any = config
    for part in key.split("."):
        node = node.get(part) if isinstance(node, Mapping) else None
    if node is None and optional:
        return None
    if isinstance(node, str):
        with contextlib.suppress(ValueError):
            node = float(node)  # YAML 1.1 reads 1e-6 as text
    if isinstance(node, bool) or not isinstance(node, int | float):
        raise ConfigError(f"{key} is {node!r}; it must be a number.")
    return node


def typed_options(cls: type[Any], given: Mapping[str, Any], group: str) -> dict[str, Any]:
    """Return options with the types that the fields of a settings dataclass have by default.

    Args:
        cls: The dataclass.
        given: Options by name.
        group: Their group, for messages.

    Raises:
        ConfigError: If an option is unknown or has another type.
    """
    defaults = {field.name: field.default for field in fields(cls)}
    values: dict[str, Any] = {}
    for name, value in given.items():
        key = f"{group}.{name}"
        if name not in defaults:
            near = difflib.get_close_matches(str(name), list(defaults), n=1)
            hint = f"did you mean '{group}.{near[0]}'?" if near else f"there are {', '.join(defaults)}."
            raise ConfigError(f"There is no option '{key}'; {hint}")
        default = defaults[name]
        if isinstance(default, bool) and not isinstance(value, bool):
            raise ConfigError(f"{key} is {value!r}; it must be true or false.")
        if isinstance(default, int | float) and not isinstance(default, bool):
            value = number({group: given}, key)
            value = whole(value, key) if isinstance(default, int) else float(value)
        values[str(name)] = value
    return values


def whole(value: float, key: str) -> int:
    """Return a number as a whole one.

    Raises:
        ConfigError: If it is not whole.
    """
    if value != int(value):
        raise ConfigError(f"{key} is {value}; it must be a whole number.")
    return int(value)
