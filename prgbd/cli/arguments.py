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
_DIGITS = re.compile(r"\d{4000}")  # Python reads no longer numbers
_PATHS = (
    "root",
    "weights",
    "imagenet_weights",
    "camera",
    "split",
    "load_map",
    "save_map",
    "cache",
    "trajectory",
    "out",
)
"""Last names of options that are files or folders."""
_SPECIAL = re.compile(r"[,\[\]{}'\"$]")  # what Hydra has a use for in the value of such an option
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
    arguments: list[str] = []
    flag_takes_next = False
    for number, argument in enumerate(argv):
        if flag_takes_next or argument.startswith("-"):
            if not flag_takes_next:
                _check_flag(argument, argv[number + 1 :])
            flag_takes_next = not flag_takes_next and argument in FLAGS_WITH_VALUE
            arguments.append(argument)
            continue
        found = _OVERRIDE.match(argument)
        if found is None or (found["value"] is None and found["prefix"] != "~"):
            raise ConfigError(f"'{argument}' is not understood; {_meant(argument, argv[:number], argv[number + 1 :])}")
        if _DIGITS.search(found["value"] or ""):
            raise ConfigError(f"{found['key']} is a number of thousands of digits; write a smaller one.")
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
        return f"++{key}={_quoted(value, key)}"
    return f"{prefix or ''}{key}={_quoted(value, key)}"


def _quoted(value: str, key: str) -> str:
    """Put quotes around a file or folder: Hydra reads brackets, commas and accents as its own.

    One that is not there is left alone where Hydra may have a use for what is in it, such as a list for a sweep.
    """
    names_path = key.rpartition(".")[2] in _PATHS and not _SPECIAL.search(value)
    if _PLAIN.match(value) or not (names_path or os.path.exists(os.path.expanduser(value))):
        return value
    escaped = value.replace("'", r"\'")
    return f"'{escaped}'"


def _meant(argument: str, before: Sequence[str], after: Sequence[str]) -> str:
    """Say what to write in place of an argument that is no ``option=value``.

    Args:
        argument: What is not understood.
        before: The arguments before it.
        after: Those behind it.
    """
    if any(quote in argument for quote in "“”‘’"):
        return "it has curly quotes: write straight ones (\" or '), or none."
    if argument.count("=") > 1 and " " in argument:
        return "give every option=value as a word of its own, without quotes around all of them."
    if " = " in argument or after[:1] == ["="] or argument == "=":
        return "write option=value without spaces around =."
    if argument in GROUPS:
        return f"write {argument}={after[0] if after and '=' not in after[0] else 'CHOICE'}."
    if before and before[-1].endswith("="):
        return f"write {before[-1]}{argument} without a space."
    if before and before[-1].partition("=")[0].rpartition(".")[2] in _PATHS:
        return f'a value with spaces needs quotes: "{before[-1]} {argument}".'
    if os.path.isfile(argument):
        return f"for a video write data=video data.root={argument}, and see --help."
    return "write option=value, or see --help."


def _check_flag(argument: str, after: Sequence[str]) -> None:
    name, equals, value = argument.partition("=")
    if name in FLAGS:
        return
    option = name.lstrip("-")
    near = difflib.get_close_matches(name, FLAGS, n=1)
    if option in GROUPS:
        value = value if equals else after[0] if after else "CHOICE"
        hint = f"options have no dashes: {option}={value}."
    elif near:
        hint = f"did you mean {near[0]}?"
    else:
        hint = f"options are written option=value{f' ({option}={value})' if equals else ''}, see --help."
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
