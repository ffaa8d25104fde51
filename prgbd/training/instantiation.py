"""Lightning's objects from a configuration: mappings with ``_target_``, as ``hydra.utils.instantiate`` reads them."""

from __future__ import annotations

import inspect
import pydoc
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from lightning.pytorch.loggers import Logger

from prgbd.core.errors import ConfigError


def listed(value: Any) -> list[Any]:
    """Return one or several values, or those of a mapping of names, as a list; an empty one for None and false."""
    if value is None or value is False:
        return []
    if isinstance(value, Mapping) and "_target_" not in value:
        return [entry for entry in value.values() if entry is not None]
    return list(value) if isinstance(value, list | tuple) else [value]


def made(option: str, value: Any, folder: Path | None = None) -> Any:
    """Make what a mapping with ``_target_`` describes; return anything else as it is.

    Args:
        option: Name of the option of ``trainer``, for messages.
        value: An object, or a description of one.
        folder: Becomes ``save_dir`` of a logger that takes one and is not told another.

    Raises:
        ConfigError: If the class is not found or refuses its options.
    """
    if not (isinstance(value, Mapping) and "_target_" in value):
        return value
    target = value["_target_"]
    try:
        return instantiate({**_saved_in(folder, target), **value}, _convert_="all")
    except InstantiationException as error:
        if error.__cause__ is None or "locating" in str(error):
            raise ConfigError(
                f"There is no class '{target}', which trainer.{option} names; check its spelling, and that its package "
                "is installed."
            ) from error
        reason = " ".join(str(error.__cause__).split()).rstrip(".")
        raise ConfigError(f"{target}, which trainer.{option} names, does not take its options: {reason}.") from error


def all_of(cls: type[Any], option: str, values: list[Any]) -> list[Any]:
    """Return the values, all of which must be of one class.

    Raises:
        ConfigError: If one is not.
    """
    for value in values:
        if not isinstance(value, cls):
            raise ConfigError(
                f"trainer.{option} holds {value!r}, which is no {cls.__name__} of Lightning; give objects, or mappings "
                "such as {_target_: package.Class}."
            )
    return values


def _saved_in(folder: Path | None, target: Any) -> dict[str, str]:
    cls = pydoc.locate(str(target)) if folder is not None else None
    takes = inspect.isclass(cls) and issubclass(cls, Logger) and "save_dir" in inspect.signature(cls).parameters
    return {"save_dir": str(folder)} if takes else {}
