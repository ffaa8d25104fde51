"""The errors a user can mend. Each message is one sentence that names the file or option and the mend."""

from __future__ import annotations

import re
from typing import ClassVar

from prgbd.core.exit_codes import ExitCode

# A path, a name or a value of the input's; the longest path that Linux opens would fill a screen with 4096 characters.
_LONG_WORD = re.compile(r"(\S{60})\S{180,}(\S{40})")


class PrgbdError(Exception):
    """Base of every error that is the input's fault, not the program's.

    The command line prints the message alone and exits with ``exit_code``; anything that is not a
    ``PrgbdError`` is a bug in prgbd and keeps its traceback.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.INPUT

    def __str__(self) -> str:
        """The message, with what the input put into it kept to a length that somebody still reads."""
        return _LONG_WORD.sub(r"\1...\2", super().__str__())


class ConfigError(PrgbdError):
    """An option of the command line or of a constructor has a value that cannot work."""


class DataError(PrgbdError):
    """Something that should be read (images, calibration, poses) is absent or malformed."""


class WeightsError(PrgbdError):
    """A weight file is absent, unreadable, or belongs to another network."""


class UnknownPluginError(PrgbdError):
    """No plug-in is registered under the id; the message names the nearest ones."""


class BrokenPluginError(PrgbdError):
    """A plug-in was found, but importing or constructing it failed."""


class ContractError(PrgbdError):
    """A plug-in broke the interface: wrong shape, unit, order of calls, or a value that is not finite."""


class SlamError(PrgbdError):
    """SLAM produced nothing that the next step could use (for example: it never initialised)."""


class DiskError(PrgbdError):
    """A file or folder cannot be written: no room, no permission, a name that is too long."""


class NothingTrackedError(PrgbdError):
    """A whole run ended, and SLAM has found no trajectory in it."""

    exit_code = ExitCode.NOTHING_TRACKED


class PartlyFailedError(PrgbdError):
    """A run of several recordings ended, and some of them failed."""

    exit_code = ExitCode.PARTLY_FAILED
