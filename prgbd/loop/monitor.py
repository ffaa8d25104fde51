"""``Monitor``: how the loop tells what it is doing, without knowing who looks."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Protocol


class Progress(Protocol):
    """One stage with a known number of units."""

    def advance(self, units: int = 1, **fields: Any) -> None:
        """Count finished units and show ``fields``, for example ``state="ok", keyframes=12``."""

    def leave_out(self, seconds: float) -> None:
        """Take the last seconds out of the rate: they went into something else, such as compiling."""


class Monitor(Protocol):
    """Somebody who watches a run."""

    def stage(self, title: str, total: int) -> contextlib.AbstractContextManager[Progress]:
        """Open a stage of ``total`` units."""

    def say(self, text: str) -> None:
        """Tell one line."""


class _Silent:
    def advance(self, units: int = 1, **fields: Any) -> None:
        """Do nothing."""

    def leave_out(self, seconds: float) -> None:
        """Do nothing."""


class SilentMonitor:
    """Watches without a word."""

    @contextlib.contextmanager
    def stage(self, title: str, total: int) -> Iterator[Progress]:
        """See ``Monitor.stage``."""
        yield _Silent()

    def say(self, text: str) -> None:
        """See ``Monitor.say``."""


class PrintingMonitor(SilentMonitor):
    """Prints every line, and nothing of the progress within a stage."""

    def say(self, text: str) -> None:
        """See ``Monitor.say``."""
        print(text, flush=True)
