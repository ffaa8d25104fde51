"""Names of recordings that serve as names of files and folders, and that no two recordings share."""

from __future__ import annotations

import hashlib
import re
import unicodedata

MOST_BYTES = 120
"""Of a name in UTF-8. File systems allow 255, and names get endings and marks of temporary files added."""

_KEPT = ("L", "M", "N")  # letters, their accents and vowel signs, and digits of every script
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # devices of Windows
_MARKED = re.compile(r"-x[0-9a-f]{8}$")


def safe_name(text: str) -> str:
    """Return a text as a name of files; letters and digits of every script, ``-``, ``_`` and ``.`` are kept.

    Where something had to be replaced or left out, a digest of the text is appended, so that two texts never get one
    name: ``my walk`` becomes ``my_walk-x`` and eight digits, and ``my_walk`` stays what it is.
    """
    composed = unicodedata.normalize("NFC", text)
    words = "".join(c if c in "._-" or unicodedata.category(c)[0] in _KEPT else " " for c in composed).split()
    name = "_".join(words).lstrip(".-").rstrip(".")
    name = name.encode("utf-8")[:MOST_BYTES].decode("utf-8", errors="ignore") or "recording"
    if name == text and not _RESERVED.fullmatch(name) and not _MARKED.search(name):
        return name
    return f"{name}-x{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"
