"""Messages of ``sensor_msgs`` as images, depth and cameras."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.plugins.data._camera_files import translated
from prgbd.plugins.data._images import colour, decoded

DEPTH = ("16UC1", "32FC1")  # encodings of depth (REP 118): millimetres and metres
Layout = tuple[str, int, int | None]  # type of a value, values of a pixel, OpenCV's way to RGB

_BAYER = {
    f"bayer_{pattern.lower()}{8 * size}": (f"u{size}", 1, getattr(cv2, f"COLOR_Bayer{pattern}2RGB"))
    for pattern in ("RGGB", "BGGR", "GBRG", "GRBG")
    for size in (1, 2)
}
LAYOUTS: dict[str, Layout] = {
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1, cv2.COLOR_GRAY2RGB)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1, cv2.COLOR_GRAY2RGB)),
    "rgb8": ("u1", 3, None),
    "rgb16": ("u2", 3, None),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2RGB),
    **dict.fromkeys(("bgr8", "8UC3"), ("u1", 3, cv2.COLOR_BGR2RGB)),
    "bgr16": ("u2", 3, cv2.COLOR_BGR2RGB),
    **dict.fromkeys(("bgra8", "8UC4"), ("u1", 4, cv2.COLOR_BGRA2RGB)),
    **dict.fromkeys(("yuv422", "uyvy"), ("u1", 2, cv2.COLOR_YUV2RGB_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), ("u1", 2, cv2.COLOR_YUV2RGB_YUY2)),
    **_BAYER,
}
"""How pictures of each encoding of ``sensor_msgs/Image`` lie in memory."""
DEPTH_LAYOUTS: dict[str, Layout] = {"16UC1": ("u2", 1, None), "mono16": ("u2", 1, None), "32FC1": ("f4", 1, None)}
_COMPRESSED_DEPTH = 12  # bytes of a header before the PNG of the transport compressedDepth


def is_depth(message: Any) -> bool:
    """Tell whether an image message holds depth, by its encoding."""
    words = re.split(r"[;\s]+", getattr(message, "encoding", "") or getattr(message, "format", ""))
    return words[0] in DEPTH or "compressedDepth" in words


def image_of(message: Any, where: str) -> NDArray[Any]:
    """Return the picture of an ``Image`` or ``CompressedImage``, (H, W, 3) RGB with 8 or 16 bits.

    Raises:
        DataError: If it is damaged or of an unknown encoding; ``where`` names it.
    """
    if hasattr(message, "format"):
        if re.search(r"compressed\s+bayer", message.format):
            raise DataError(f"{where} is a compressed mosaic ({message.format}); record the colour topic instead.")
        return np.asarray(cv2.cvtColor(colour(bytes(message.data), where), cv2.COLOR_BGR2RGB))
    values, code = _values(message, LAYOUTS, where)
    try:
        return values if code is None else np.asarray(cv2.cvtColor(values, code))
    except cv2.error as error:  # such as an odd width of pixels in pairs
        raise DataError(f"{where} of {message.width}x{message.height} pixels cannot be {message.encoding}.") from error


def depth_of(message: Any, where: str) -> NDArray[Any]:
    """Return the numbers of a depth image, (H, W): whole ones are millimetres, others metres.

    Raises:
        DataError: If it is damaged or of an unknown encoding; ``where`` names it.
    """
    if not hasattr(message, "format"):
        return _values(message, DEPTH_LAYOUTS, where)[0]
    if not message.format.startswith("16UC1"):
        raise DataError(f"{where} holds {message.format}; of compressed depth 16UC1 as PNG is read, so record that.")
    skipped = _COMPRESSED_DEPTH if "compressedDepth" in message.format else 0
    levels = decoded(bytes(message.data)[skipped:], cv2.IMREAD_UNCHANGED, where)
    if levels.ndim != 2 or levels.dtype != np.uint16:
        raise DataError(f"{where} holds {levels.dtype} of shape {levels.shape}, which is no depth in millimetres.")
    return levels


def camera_values(message: Any, rectified: bool, where: str) -> Mapping[str, Any] | None:
    """Return what a ``CameraInfo`` says in the words of prgbd's camera files; None if it is not calibrated.

    Args:
        message: The message.
        rectified: Whether the images are rectified already, so that the projection matrix counts, without distortion.
        where: Names it in errors.

    Raises:
        DataError: If the distortion model is not known.
    """
    K, D, P = ([float(v) for v in getattr(message, key, getattr(message, key.lower(), ()))] for key in "KDP")
    size = {"width": int(message.width), "height": int(message.height)}
    matrix = [*P[:3], *P[4:7], *P[8:11]] if rectified else K
    if not any(matrix):
        return None
    model = {"distortion_model": message.distortion_model} if message.distortion_model else {}
    return translated({"K": matrix, "D": [] if rectified else D, **size, **({} if rectified else model)}, where)


def _values(message: Any, layouts: Mapping[str, Layout], where: str) -> tuple[NDArray[Any], int | None]:
    """Return the pixels of an ``Image``, (H, W) or (H, W, channels), and OpenCV's way to RGB; rows may be padded."""
    if message.encoding not in layouts:
        raise DataError(f"{where} has the encoding '{message.encoding}'; known are {', '.join(layouts)}.")
    kind, channels, code = layouts[message.encoding]
    width, height, step = int(message.width), int(message.height), int(message.step)
    row, data = width * channels * int(kind[1]), np.asarray(message.data, np.uint8)
    if min(width, height) < 1 or step < row or len(data) < step * height:
        raise DataError(
            f"{where} has {len(data)} bytes, too few for {width}x{height} pixels of {message.encoding}; the message is "
            "damaged, leave it out with data.start and data.stop."
        )
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row])
    values = rows.view(f"{'>' if message.is_bigendian else '<'}{kind}").astype(kind)
    return (values if channels == 1 else values.reshape(height, width, channels)), code
