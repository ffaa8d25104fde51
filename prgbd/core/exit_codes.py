"""The exit codes of all commands."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """What the exit code of a command says; ``docs/running.md`` tells users."""

    DONE = 0
    BUG = 1  # of prgbd, with a traceback; Python itself exits so
    INPUT = 2  # what the user can mend: an option, a file, a plug-in, the disk
    NOTHING_TRACKED = 3  # the run ended, and no trajectory was found
    PARTLY_FAILED = 4  # the run ended, and some of its recordings failed
    STOPPED = 130  # by Ctrl-C
    CLOSED = 141  # whoever read the output went away, as in ``| head``
