"""Options: from plain values, as YAML and the command line give them, to the dataclass that is their one source.

A dataclass says the name, the type, the default and (in its ``__post_init__``) the range of every option of a part;
its docstring says what each means. ``from_mapping`` makes one of what a user gave and says in one sentence what cannot
work; ``checked_arguments`` does so for the keyword parameters of a plug-in that names no dataclass; ``option_schema``
makes it a structured config for Hydra's ConfigStore, so that the command line knows the same names and types.

Types are checked and converted by OmegaConf (``"1e-6"`` is a float, ``true`` is no whole number, a list serves for a
tuple). What OmegaConf 2.3 does not know is decided here by the annotation alone: ``Literal``, alternatives such as
``int | Literal["auto"]``, the length of a tuple, ``3.0`` for a whole number, and that 1 is not true. Values of other
types (a ``Camera``, an array) pass as they are.
"""

from __future__ import annotations

import functools
import inspect
import math
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass, make_dataclass
from pathlib import Path
from types import NoneType, SimpleNamespace, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeGuard,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from prgbd.core.errors import ConfigError
from prgbd.core.option_errors import dotted, refused, shown, unknown_option
from prgbd.core.option_ranges import Range

if TYPE_CHECKING:
    from omegaconf import DictConfig

T = TypeVar("T")
_INT64 = Range(-(2**63), 2**63 - 1)


def from_mapping(cls: type[T], given: Mapping[str, Any], prefix: str = "") -> T:
    """Make a dataclass of options; what is not given keeps its default.

    Args:
        cls: The dataclass, frozen or not. Its fields may be dataclasses again: groups of options.
        given: Plain values by name, those of a group in a mapping of their own.
        prefix: The dotted name of the options' group on the command line, such as ``training``; "" for none.

    Returns:
        An instance of ``cls``.

    Raises:
        ConfigError: If an option is unknown, absent without a default, or has a value of the wrong type; the message
            holds its full dotted name. What ``__post_init__`` raises passes as it is.
    """
    return _made(cls, given, prefix, option_types(cls, prefix))


def _made(cls: type[T], given: Mapping[str, Any], prefix: str, all_names: Collection[str]) -> T:
    """Make a dataclass, which may be a group of a larger one; ``all_names`` are what an unknown name may stand for."""
    hints = field_types(cls)
    known = {option.name: option for option in fields(cls)}  # type: ignore[arg-type]
    _check_names(given, known, prefix, all_names)
    values = {}
    for name, option in known.items():
        key = dotted(prefix, name)
        if name not in given:
            if option.default is MISSING and option.default_factory is MISSING:
                raise ConfigError(f"The option {key} has no default; add {key}=...")
        elif is_group(hints[name]) and isinstance(given[name], Mapping):
            values[name] = _group(hints[name], option, given[name], key, all_names)
        else:
            values[name] = converted(given[name], hints[name], key)
    return cls(**values)


def check_types(options: Any, prefix: str = "") -> None:
    """Check the types of a dataclass that was made from Python, in its ``__post_init__``; nothing is converted.

    Raises:
        ConfigError: If a field has a value that its annotation does not allow.
    """
    hints = field_types(type(options))
    for option in fields(options):
        value, key = getattr(options, option.name), dotted(prefix, option.name)
        meant = converted(value, hints[option.name], key)
        if meant != (tuple(value) if isinstance(meant, tuple) else value):
            raise refused(key, value, hints[option.name])


def checked_arguments(target: Callable[..., Any], given: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return keyword arguments with the types that a function or class has in its signature.

    Args:
        target: What will be called; one that takes ``**kwargs`` judges for itself, and gets ``given`` as it is.
        given: Keyword arguments, plain values.
        prefix: The dotted name of the options' group on the command line, such as ``slam``.

    Raises:
        ConfigError: If an argument is unknown, absent without a default, or has a value of the wrong type.
    """
    if any(p.kind is p.VAR_KEYWORD for p in inspect.signature(target).parameters.values()):
        return dict(given)
    known = keyword_parameters(target)
    _check_names(given, known, prefix, [dotted(prefix, name) for name in known])
    absent = [dotted(prefix, n) for n, p in known.items() if p.default is p.empty and n not in given]
    if absent:
        raise ConfigError(f"The option {' and '.join(absent)} has no default; add {absent[0]}=...")
    return {
        name: converted(value, _hint(target, name, known[name].annotation), dotted(prefix, name))
        for name, value in given.items()
    }


def keyword_parameters(target: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a function or class that can be given by name."""
    parameters = inspect.signature(target).parameters
    return {n: p for n, p in parameters.items() if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}


def option_types(cls: type[Any], prefix: str = "") -> dict[str, Any]:
    """Return the types of all options of a dataclass by their dotted names, those of its groups included."""
    types: dict[str, Any] = {}
    hints = field_types(cls)
    for option in fields(cls):
        key, hint = dotted(prefix, option.name), hints[option.name]
        types |= option_types(hint, key) if is_group(hint) else {key: hint}
    return types


def is_group(annotation: Any) -> TypeGuard[type[Any]]:
    """Say whether a type is a dataclass, and so a group of options."""
    return isinstance(annotation, type) and is_dataclass(annotation)


def _group(cls: type[Any], option: Field[Any], given: Mapping[str, Any], key: str, all_names: Collection[str]) -> Any:
    """Make a nested dataclass; its defaults are those of the field that holds it."""
    if option.default is MISSING and option.default_factory is MISSING:
        return _made(cls, given, key, all_names)
    default = {f.name: getattr(default_of(option), f.name) for f in fields(cls)}
    return _made(cls, default | dict(given), key, all_names)


def converted(value: Any, annotation: Any, key: str) -> Any:
    """Return a value with the type of an annotation, or raise a ConfigError with the option's name."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _in_range(value, annotation, key)
    if is_group(annotation):
        if isinstance(value, annotation):
            return value
        if isinstance(value, Mapping):
            return from_mapping(annotation, value, key)
        raise refused(key, value, annotation)
    if origin is Literal:
        for part in parts:
            if type(value) is type(part) and value == part:
                return value
        raise refused(key, value, annotation)
    if origin in (Union, UnionType):
        return _alternative(value, annotation, key)
    if origin in (list, tuple):
        return _sequence(value, annotation, key)
    if origin is dict:
        if not isinstance(value, Mapping):
            raise refused(key, value, annotation)
        return {str(name): converted(item, parts[1], dotted(key, name)) for name, item in value.items()}
    if annotation in (int, float, bool) and getattr(value, "shape", None) == ():
        value = value.item()  # a scalar of numpy's
    if annotation is bool and isinstance(value, int) and not isinstance(value, bool):
        raise refused(key, value, annotation)
    if annotation in (int, float):
        return _number(value, annotation, key)
    if annotation is str and isinstance(value, float) and not math.isfinite(value):
        raise refused(key, value, annotation)  # what a broken calculation left; a text of that name has quotes
    return _by_omegaconf(value, annotation, key)


def _number(value: Any, kind: type[int] | type[float], key: str) -> Any:
    """Convert a number; NaN, infinity and what does not fit into 64 bits are none."""
    if kind is int and isinstance(value, float) and value.is_integer():
        value = int(value)
    if kind is int and isinstance(value, float):
        raise refused(key, value, kind)
    number = _by_omegaconf(value, kind, key)
    if kind is float and not math.isfinite(number):
        raise refused(key, number, kind)
    if kind is int and not _INT64.least <= number <= _INT64.most:
        raise ConfigError(f"{key} is {shown(number)}; it must be a whole number of 64 bits.")
    return number


def _in_range(value: Any, annotation: Any, key: str) -> Any:
    """Convert a value that must lie in the ranges of its annotation."""
    kind, *notes = get_args(annotation)
    try:
        meant = converted(value, kind, key)
    except ConfigError:
        raise refused(key, value, annotation) from None  # names the range as well
    if any(isinstance(note, Range) and meant not in note for note in notes):
        raise refused(key, meant, annotation)
    return meant


def _alternative(value: Any, annotation: Any, key: str) -> Any:
    """Convert to the first of several types that takes a value: its own before others, text only for text."""
    parts = get_args(annotation)
    if value is None and NoneType in parts:
        return None
    for part in sorted(parts, key=lambda part: (get_origin(part) is not Literal, not _is_of(value, _plain(part)))):
        if part is NoneType or (part is str and (isinstance(value, bool) or not isinstance(value, str | int | Path))):
            continue
        try:
            return converted(value, part, key)
        except ConfigError:
            if is_group(part) and isinstance(value, Mapping):
                raise  # the sentence about the option within the group says more
    raise refused(key, value, annotation)


def _plain(annotation: Any) -> Any:
    """Return a type without its range."""
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _is_of(value: Any, kind: Any) -> bool:
    """Say whether a value has a type already; true and false are no numbers."""
    return isinstance(kind, type) and isinstance(value, kind) and isinstance(value, bool) == (kind is bool)


def _sequence(value: Any, annotation: Any, key: str) -> Any:
    """Convert the entries of a list or tuple."""
    kind, parts = get_origin(annotation), get_args(annotation)
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise refused(key, value, annotation)
    fixed = kind is tuple and Ellipsis not in parts
    if fixed and len(value) != len(parts):
        raise refused(key, list(value), annotation)
    types = parts if fixed else [parts[0]] * len(value)
    try:
        entries = [converted(item, part, key) for item, part in zip(value, types, strict=True)]
    except ConfigError:
        raise refused(key, list(value), annotation) from None
    return tuple(entries) if kind is tuple else entries


def _by_omegaconf(value: Any, annotation: Any, key: str) -> Any:
    """Let OmegaConf convert a value; one of a type that it does not know passes."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    box = None if annotation is Any else box_of(annotation)
    if box is None:
        return value
    try:
        return OmegaConf.to_container(OmegaConf.merge(box, {"value": value}))["value"]  # type: ignore[call-overload, index]
    except (OmegaConfBaseException, ValueError, OverflowError):  # the latter of numbers with thousands of digits
        raise refused(key, value, annotation) from None


@functools.cache
def box_of(annotation: Any) -> DictConfig | None:
    """Return a structured config with one ``value`` of a type, or None if OmegaConf does not know the type."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    several = get_origin(annotation) in (Union, UnionType) and len(set(get_args(annotation)) - {NoneType}) > 1
    if several:  # OmegaConf takes no 3 for ``float | str``
        return None
    try:
        return OmegaConf.structured(make_dataclass("Box", [("value", annotation, "???")]))
    except (OmegaConfBaseException, TypeError):
        return None


def default_of(option: Field[Any]) -> Any:
    """Return the default of a field that has one."""
    return option.default if option.default_factory is MISSING else option.default_factory()


def _check_names(given: Mapping[str, Any], names: Iterable[str], prefix: str, known: Iterable[str]) -> None:
    if not isinstance(given, Mapping):
        raise ConfigError(f"{prefix} is {shown(given)}; it must be a group of options.")
    for name in given:
        if name not in names:
            raise unknown_option(dotted(prefix, name), known)


def field_types(cls: Any, *, ranges: bool = True) -> dict[str, Any]:
    """Return the types of a dataclass's fields; Any for one that names what is not imported when it runs.

    Args:
        cls: The dataclass.
        ranges: Whether types are ``Annotated`` with their ranges.
    """
    try:
        return get_type_hints(cls, include_extras=ranges)
    except Exception:  # an annotation may raise anything
        return {option.name: _hint(cls, option.name, option.type, ranges=ranges) for option in fields(cls)}


def _hint(owner: Any, name: str, annotation: Any, *, ranges: bool = True) -> Any:
    """Return the type of one field or parameter."""
    if annotation is inspect.Parameter.empty:
        return Any
    module = vars(sys.modules.get(owner.__module__, sys.modules[__name__]))
    holder = SimpleNamespace(__annotations__={name: annotation})
    try:
        return get_type_hints(holder, globalns=module, include_extras=ranges)[name]
    except Exception:  # an annotation may raise anything
        return Any
