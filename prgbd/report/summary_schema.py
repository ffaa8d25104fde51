"""What a ``summary.json`` may hold: docs/summary-schema.md as types, checked where the file is read."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from prgbd.core.errors import ContractError, DataError
from prgbd.core.validation import check_name

OTHER = "*"
"""Stands for every key that a group does not name."""


def _number(value: Any) -> bool:
    try:
        return isinstance(value, int | float) and math.isfinite(float(value))
    except OverflowError:
        return False


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _name(value: Any) -> bool:
    try:
        check_name(value, "It")
    except ContractError:
        return False
    return True


def _inside(value: Any) -> bool:
    return _text(value) and not value.startswith("/") and ".." not in value.split("/")


def _cap(value: Any) -> bool:
    return _number(value) or (isinstance(value, list) and len(value) == 2 and all(map(_number, value)))


def _scalar(value: Any) -> bool:
    return _text(value) or _number(value)


_WORDS: dict[Callable[[Any], bool], str] = {
    _number: "a number",
    _text: "a text",
    _name: "a name that a file can have",
    _inside: "a folder of the run",
    _scalar: "a number or a text",
    _cap: "a depth, or the nearest and the farthest one",
}
_NUMBERS = {OTHER: _number}
_POSE = {
    **dict.fromkeys(("mode", "alignment", "kitti_alignment", "reason", "failed"), _text),
    "doubts": [_text],
    OTHER: _number,
}
_DEPTH = {
    **dict.fromkeys(("crop", "reason"), _text),
    "cap": _cap,
    **dict.fromkeys(("near", "far"), _NUMBERS),
    "by_depth": [_NUMBERS],
    "by_cap": [{"cap": _cap, OTHER: _number}],
    OTHER: _number,
}
_UNCERTAINTY = {"calibration": [_NUMBERS], "sparsification": [_NUMBERS], OTHER: _number}
_LOOP = {
    "loop": _number,
    "name": _text,
    "folder": _inside,
    "pose": {OTHER: _POSE},
    "depth": _DEPTH,
    "uncertainty": {OTHER: _UNCERTAINTY},
    "training": {"still_frames": _NUMBERS, OTHER: _scalar},
    "baseline": _NUMBERS,
    "depth_max": _NUMBERS,
    "seconds": _number,
    "rolled_back": _number,
}
SUMMARY = {
    **dict.fromkeys(("prgbd", "task", "slam", "depth", "data", "failed"), _text),
    **dict.fromkeys(("schema", "seed", "seconds"), _number),
    "sequences": [_name],
    "test_sequences": [_name],
    "depth_tests": [_name],
    "loops": [_LOOP],
    "baselines": [_LOOP],
    "failed_sequences": {OTHER: _text},
    "recipe": [{"loop": _number, "choices": [{"value": _scalar, OTHER: _text}], "sentences": [_text]}],
    "stop": {"reason": _text, "best_loop": _number},
    "versions": {OTHER: _text},
}


def check_summary(summary: Any, path: Any) -> dict[str, Any]:
    """Return a summary whose entries have the documented types; any may be absent or null, and others be there.

    Raises:
        DataError: If one has another type; the message names it.
    """
    _check(summary, SUMMARY, "", path)
    if not isinstance(summary, dict):
        raise _refused(path, "", "a group")
    for row in (*(summary.get("loops") or []), *(summary.get("baselines") or [])):
        if not isinstance(row, dict) or not all(map(_name, row.get("pose") or {})):
            raise _refused(path, "loops", "a list of loops, with poses by names that files can have")
    return summary


def _check(value: Any, wanted: Any, where: str, path: Any) -> None:
    if value is None:
        return
    if isinstance(wanted, list):
        if not isinstance(value, list) or None in value:
            raise _refused(path, where, "a list")
        for row, entry in enumerate(value):
            _check(entry, wanted[0], f"{where}[{row}]", path)
    elif isinstance(wanted, Mapping):
        if not isinstance(value, dict):
            raise _refused(path, where, "a group")
        for key, entry in value.items():
            if key in wanted or OTHER in wanted:
                _check(entry, wanted.get(key, wanted.get(OTHER)), f"{where}.{key}" if where else str(key), path)
    elif not wanted(value):
        raise _refused(path, where, _WORDS[wanted])


def _refused(path: Any, where: str, wanted: str) -> DataError:
    what = f"{where[:80]} must be {wanted}" if where else f"it must be {wanted}"
    return DataError(
        f"{path} is not a run summary ({what}, see docs/summary-schema.md); delete it, and resume= writes it anew."
    )
