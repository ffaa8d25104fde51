"""How every file of the user's is found and opened: no hidden files, nothing that blocks, text of any encoding."""

from __future__ import annotations

import codecs
import stat
from collections.abc import Iterable
from pathlib import Path

from prgbd.core.errors import DataError

# UTF-32's mark for little-endian begins with UTF-16's, so it is asked for first.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def require_file(path: Path | str, what: str) -> Path:
    """Return the path of a file that can be opened without waiting.

    Args:
        path: The file.
        what: What it is, for the message, such as ``"the camera file"``.

    Raises:
        DataError: If it is absent, a folder, or a pipe or device, which would block or never end.
    """
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise DataError(f"There is no file {path} ({what}); check the path.") from None
    except (OSError, ValueError) as error:  # too long a name, no permission, a loop of links, a NUL in the name
        raise DataError(f"{path} ({what}) cannot be opened ({_reason(error)}); check the path.") from error
    if stat.S_ISDIR(mode):
        raise DataError(f"{path} ({what}) is a folder; name a file.")
    if not stat.S_ISREG(mode):
        raise DataError(f"{path} ({what}) is a pipe or a device; copy its content into a file.")
    return path


def read_text(path: Path | str, what: str) -> str:
    r"""Read a text file whatever wrote it: byte order marks and ``\r\n`` are taken away.

    Without a mark it is UTF-8, and where it is not, Windows's code page 1252.

    Args:
        path: The file.
        what: What it is, for the message.

    Raises:
        DataError: If it cannot be opened, or is no text.
    """
    path = require_file(path, what)
    try:
        return decode(path.read_bytes())
    except OSError as error:
        raise DataError(f"{path} ({what}) cannot be read ({_reason(error)}); check the file.") from error
    except UnicodeError as error:
        raise DataError(f"{path} ({what}) is no text; copy it anew.") from error


def decode(data: bytes) -> str:
    r"""Return the text of a file's content, with ``\n`` between its lines.

    Raises:
        UnicodeError: If it is no text.
    """
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "")
    if not encoding and b"\0" in data:
        raise UnicodeError("binary data")
    try:
        text = data.decode(encoding or "utf-8")
    except UnicodeDecodeError:
        if encoding:
            raise
        text = data.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def visible(folder: Path, suffixes: Iterable[str] = ()) -> list[Path]:
    """Return what lies in a folder in order of its names, without hidden files.

    Hidden are names that begin with a dot, such as ``._GX010001.MP4``, which macOS leaves beside every file that it
    copies to a memory card.

    Args:
        folder: The folder.
        suffixes: Endings of the files to return, in lower case with the dot; none takes everything, folders too.

    Raises:
        DataError: If the folder cannot be listed.
    """
    wanted = tuple(suffixes)
    try:
        found = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
        return [path for path in found if path.suffix.lower() in wanted and not path.is_dir()] if wanted else found
    except (OSError, ValueError) as error:
        raise DataError(f"The folder {folder} cannot be listed ({_reason(error)}); check the path.") from error


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
