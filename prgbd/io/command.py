"""How a command ends: its sentence and its exit code."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Callable

from prgbd.core.errors import PrgbdError
from prgbd.core.exit_codes import ExitCode
from prgbd.io.disk import unwritable


def complain(message: str) -> None:
    """Print one sentence on the error stream; paths that would fill the screen are cut."""
    readable = re.sub(r"\S{300,}", lambda found: f"{found[0][:100]}...{found[0][-40:]}", message)
    print(f"prgbd: {readable}", file=sys.stderr, flush=True)


def exit_code(command: Callable[[], int], *, debug: bool = False) -> int:
    """Run a command and return its exit code; whatever the user can mend is told in one sentence.

    Args:
        command: Returns its exit code.
        debug: Show tracebacks.
    """
    try:
        return _told(command, debug=debug)
    except BrokenPipeError:
        # What is left in the buffers has no reader; Python would complain of that at its end.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        return ExitCode.CLOSED


def _told(command: Callable[[], int], *, debug: bool) -> int:
    try:
        code = command()
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        raise
    except KeyboardInterrupt:
        complain("Stopped.")
        return ExitCode.STOPPED
    except (PrgbdError, OSError) as error:
        told = unwritable(error) if isinstance(error, OSError) else error
        if told is None:
            raise
        if debug:
            traceback.print_exc()
        else:
            complain(str(told))
            for note in getattr(error, "__notes__", ()):
                print(note, file=sys.stderr)
        return told.exit_code
