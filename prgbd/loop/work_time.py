"""How long a SLAM system works, without the time in which numba compiles it: once per machine, about a minute."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator


class WorkTime:
    """The time of the blocks that are measured.

    Args:
        left_out: Told the seconds of each block in which numba compiled.

    Attributes:
        seconds: Time of the blocks without compiling.
        compile_seconds: Time in the blocks in which numba compiled, in any thread; 0 where nothing uses numba.
    """

    def __init__(self, left_out: Callable[[float], None]) -> None:
        self.seconds = self.compile_seconds = 0.0
        self._left_out = left_out

    @contextlib.contextmanager
    def measured(self) -> Iterator[None]:
        """Add the time of the block."""
        begin = time.perf_counter()
        with _compilation() as compiled:
            yield
        elapsed = time.perf_counter() - begin
        compiling = min(compiled(), elapsed)
        self.seconds += elapsed - compiling
        self.compile_seconds += compiling
        if compiling:
            self._left_out(compiling)


@contextlib.contextmanager
def _compilation() -> Iterator[Callable[[], float]]:
    """Yield a function that returns the seconds that numba has compiled in the block."""
    if "numba" not in sys.modules:
        yield lambda: 0.0
        return
    from numba.core.event import TimingListener, install_listener

    listener = TimingListener()
    with install_listener("numba:compile", listener):
        yield lambda: listener.duration if listener.done else 0.0
