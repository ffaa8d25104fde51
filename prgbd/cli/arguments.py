"""What the user typed, before Hydra sees it."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Sequence

from prgbd.core.errors import ConfigError
from prgbd.core.registry import KINDS, SHORT_FOR

PLUGIN_GROUPS = ("slam", "depth", "data")
"""Groups whose choices are plug-ins; of other kinds a run uses several at once, or names one in an option."""
GROUPS = ("slam", "depth", "data", "task", "loss", "trainer", "executor", "logger", "experiment")
FLAGS_WITH_VALUE = ("--cfg", "-c", "--package", "-p", "--config-dir", "-cd", "--config-name", "-cn", "--info", "-i")
FLAGS = (
    *FLAGS_WITH_VALUE,
    "--help",
    "-h",
    "--hydra-help",
    "--version",
    "--resolve",
    "--run",
    "-r",
    "--multirun",
    "-m",
    "--shell-completion",
    "-sc",
)
_OVERRIDE = re.compile(r"^(?P<prefix>\+\+|\+|~)?(?P<key>[A-Za-z_][\w./@:-]*)(?:=(?P<value>.*))?$", re.DOTALL)
_PLAIN = re.compile(r"^[A-Za-z0-9_/.-]*$|^['\"\[{]|.*\$\{")
_ONE_OF_A_SET = re.compile(rf"^(?P<kind>{'|'.join(SHORT_FOR)})\.[\w-]+$")
_PLUGIN_OPTION = re.compile(rf"^(?:{'|'.join(KINDS)})\.\w")


def normalise(argv: Sequence[str]) -> list[str]:
    """Bring the arguments into the one form that Hydra takes.

    Groups are accepted with and without a plus (``+slam=orb_gtsam`` is ``slam=orb_gtsam``); ``slam=null`` chooses none.
    Options of plug-ins are always accepted here, because only the plug-in knows which it has; it is asked when it is
    made. ``loss.edge=0.1`` is short for ``loss.edge.weight=0.1``, and so is ``augmentation.jitter=0.5`` for its
    probability.

    Args:
        argv: Arguments without the program's name.

    Returns:
        Arguments for Hydra.

    Raises:
        ConfigError: If an argument is neither a flag nor ``option=value``.
    """
    arguments = []
    flag_takes_next = False
    for argument in argv:
        if flag_takes_next or argument.startswith("-"):
            if not flag_takes_next:
                _check_flag(argument)
            flag_takes_next = not flag_takes_next and argument in FLAGS_WITH_VALUE
            arguments.append(argument)
            continue
        found = _OVERRIDE.match(argument)
        if found is None or (found["value"] is None and found["prefix"] != "~"):
            raise ConfigError(f"'{argument}' is not understood; write option=value, or see --help.")
        if found["key"] in GROUPS and found["value"] in ("null", "None"):
            continue
        arguments.append(_without_plus(argument, found))
    return arguments


def _without_plus(argument: str, found: re.Match[str]) -> str:
    key, prefix, value = found["key"], found["prefix"], found["value"]
    if prefix == "~":
        return argument
    if key in GROUPS:
        return f"{key}={value}"
    short = _ONE_OF_A_SET.match(key)
    if short is not None and not value.startswith("{"):
        return f"++{key}.{SHORT_FOR[short['kind']]}={value}"
    if _PLUGIN_OPTION.match(key):
        return f"++{key}={_quoted(value)}"
    return f"{prefix or ''}{key}={_quoted(value)}"


def _quoted(value: str) -> str:
    """Put quotes around a file or folder that is there: Hydra reads brackets, commas and accents as its own."""
    if _PLAIN.match(value) or not os.path.exists(os.path.expanduser(value)):
        return value
    escaped = value.replace("'", r"\'")
    return f"'{escaped}'"


def _check_flag(argument: str) -> None:
    name = argument.split("=", 1)[0]
    if name not in FLAGS:
        near = difflib.get_close_matches(name, FLAGS, n=1)
        hint = f"did you mean {near[0]}?" if near else "options are written option=value, see --help."
        raise ConfigError(f"There is no flag {name}; {hint}")


def is_multirun(argv: Sequence[str]) -> bool:
    """Say whether the arguments ask for a multirun."""
    return any(a in ("-m", "--multirun") for a in argv)


def value_of(argv: Sequence[str], key: str) -> str | None:
    """Return the last value that is given to ``key`` on the command line, or None."""
    value = None
    for argument in argv:
        found = _OVERRIDE.match(argument)
        if found is not None and found["key"] == key and found["prefix"] != "~":
            value = found["value"]
    return value


def is_true(value: str | None) -> bool:
    """Say whether a value from the command line means yes."""
    return value is not None and value.lower() in ("true", "yes", "on", "1")
