"""Whether an image file has its end; decoders fill the missing part with grey and stay silent."""

from __future__ import annotations

import re
import struct
import zlib

_MARKER = re.compile(rb"\xff[^\x00\xff]")
# In entropy-coded data FF 00 stands for a byte FF, and FF D0 to FF D7 are its restart marks.
_MARKER_BEHIND_SCAN = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
_WITHOUT_LENGTH = frozenset((0x01, *range(0xD0, 0xD9)))
_SCAN, _END = 0xDA, 0xD9
_PNG = b"\x89PNG\r\n\x1a\n"


def whole(data: bytes) -> bytes | None:
    """Return an image file without what may lie behind the image, or None if its end is missing.

    Phones hang films, second images and gain maps behind the end of a JPEG. Other formats than JPEG and PNG are
    returned as they are.

    Args:
        data: The content of the file.
    """
    if data.startswith(b"\xff\xd8"):
        end = _end_of_jpeg(data)
    elif data.startswith(_PNG):
        end = _end_of_png(data)
    else:
        end = len(data)
    return None if end is None else data[:end]


def _end_of_jpeg(data: bytes) -> int | None:
    """Walk from marker to marker to the image's own end: what is embedded in a segment (a thumbnail) does not count."""
    position, marker, scanned = 2, _MARKER, False
    while found := marker.search(data, position):
        kind = found[0][1]
        position, marker = found.end(), _MARKER
        if kind == _END:
            return position if scanned else None
        if kind in _WITHOUT_LENGTH:
            continue
        if position + 2 > len(data):
            return None
        position += int.from_bytes(data[position : position + 2], "big")
        if kind == _SCAN:
            scanned, marker = True, _MARKER_BEHIND_SCAN
    return None


def _end_of_png(data: bytes) -> int | None:
    """Walk from chunk to chunk; a chunk whose sum of check is wrong counts as the end of what is whole."""
    position = len(_PNG)
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        end = position + 12 + length
        if end > len(data) or zlib.crc32(data[position + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            return None
        if data[position + 4 : position + 8] == b"IEND":
            return end
        position = end
    return None
