"""Ctrl-C while Lightning trains."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C through a Lightning trainer as ``KeyboardInterrupt``.

    Lightning answers it by ignoring all further ones and leaving the program with code 1 (``SystemExit``), so nobody
    could tell the user how to go on.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    except SystemExit as end:
        if isinstance(end.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from end
        raise  # a plug-in's own
    finally:
        if in_main_thread and handler is not None:
            signal.signal(signal.SIGINT, handler)
