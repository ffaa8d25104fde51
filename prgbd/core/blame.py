"""Whose fault an exception is: one that comes out of another package's plug-in is not prgbd's bug."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from prgbd.core.errors import BrokenPluginError, PrgbdError
from prgbd.core.registry import KINDS, REGISTRY, PluginSpec

_STOPPED = 130  # what a run exits with after Ctrl-C


@contextmanager
def blaming_plugins() -> Iterator[None]:
    """Turn what a plug-in of another package raises within the block into one sentence that names it.

    Nothing that runs within the block can end the program by ``sys.exit``. Errors of the machine (a full disk) and
    exceptions of prgbd's own pass as they are.

    Raises:
        BrokenPluginError: If a plug-in raised something, or anything called ``sys.exit``.
    """
    try:
        yield
    except (PrgbdError, OSError):
        raise
    except SystemExit as error:
        if error.code == _STOPPED:
            raise
        who = _sentence(error) or "A library ended the program"
        raise BrokenPluginError(f"{who} (sys.exit({error.code!r})); mend it, or choose another plug-in.") from error
    except Exception as error:
        if who := _sentence(error):
            said = " ".join(f"{type(error).__name__}: {error}".split())
            raise BrokenPluginError(f"{who} ({said}); mend it, or choose another plug-in.") from error
        raise


def _sentence(error: BaseException) -> str:
    """Say in which plug-in an exception arose and where, "" if it passed through none."""
    specs = [spec for kind in KINDS for spec in REGISTRY.specs(kind) if spec.origin != "built-in"]
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        module = frame.f_globals.get("__name__", "")
        if spec := _owner(module, specs):
            place = f"{Path(frame.f_code.co_filename).name}:{line}, {frame.f_code.co_name}"
            return f"The {spec.kind} plug-in '{spec.id}' ({spec.origin}) failed in {place}"
    return ""


def _owner(module: str, specs: list[PluginSpec]) -> PluginSpec | None:
    """Return the plug-in that a module belongs to: its own, else one of the same package outside of prgbd."""
    package = module.partition(".")[0]
    modules = {spec.target.partition(":")[0]: spec for spec in specs}
    relatives = [spec for own, spec in modules.items() if own.partition(".")[0] == package != "prgbd"]
    return modules.get(module) or next(iter(relatives), None)
