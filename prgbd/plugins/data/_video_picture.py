"""From a decoded frame of a video to the picture that a player shows: RGB, upright, square samples, one field."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from av.video.reformatter import Interpolation, VideoReformatter
from numpy.typing import NDArray

SQUARE = 0.005  # by which samples may be wider or higher than square: encoders round, and focal lengths bear it
SQUEEZED = 4.0  # widths to heights of a sample that are believed, and their inverse


class Pictures:
    """Turns the frames of one file into pictures.

    Args:
        aspect: Width of a stored sample over its height. Unless it is 1, pictures are scaled in width.
    """

    def __init__(self, aspect: float) -> None:
        believed = 1 / SQUEEZED <= aspect <= SQUEEZED and abs(aspect - 1) > SQUARE
        self.aspect = aspect if believed else 1.0
        self._reformatter = VideoReformatter()

    def picture(self, frame: Any) -> NDArray[np.uint8]:
        """Return a frame, (H, W, 3) uint8 RGB.

        Raises:
            av.error.FFmpegError: If its pixel format cannot be converted.
        """
        if frame.interlaced_frame:  # its two fields were taken at different moments: keep one
            width, height = max(1, round(frame.width * self.aspect)), frame.height
            image = _one_field(self._rgb(frame, frame.width))
            return upright(_resized(image, width, height), matrix(frame))
        return upright(self._rgb(frame, max(1, round(frame.width * self.aspect))), matrix(frame))

    def _rgb(self, frame: Any, width: int) -> NDArray[np.uint8]:
        rgb = self._reformatter.reformat(frame, width, frame.height, "rgb24", interpolation=Interpolation.BICUBIC)
        return np.asarray(rgb.to_ndarray(), np.uint8)


def stored_size(width: int, height: int, frame: Any, aspect: float) -> tuple[int, int]:
    """Return the (width, height) of a picture before its samples were made square."""
    if aspect == 1.0:
        return width, height
    return (width, int(frame.width)) if _lies(matrix(frame)) else (int(frame.width), height)


def matrix(frame: Any) -> tuple[int, int, int, int]:
    """Return the signs of the display matrix (a, b, c, d): a point (x, y) is shown at (ax + cy, bx + dy)."""
    for data in frame.side_data:
        if data.type.name == "DISPLAYMATRIX" and data.buffer_size >= 36:
            a, b, _, c, d = np.frombuffer(bytes(data)[:20], np.int32).astype(np.int64)
            if abs(a) + abs(d) >= abs(b) + abs(c):
                return (-1 if a < 0 else 1), 0, 0, (-1 if d < 0 else 1)
            return 0, (-1 if b < 0 else 1), (-1 if c < 0 else 1), 0
    return 1, 0, 0, 1


def upright(image: NDArray[np.uint8], shown: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    """Return the (H, W, 3) image turned or mirrored as ``matrix`` says, contiguous."""
    a, b, c, d = shown
    if _lies(shown):
        image, a, d = image.transpose(1, 0, 2), c, b
    return np.ascontiguousarray(image[:: d or 1, :: a or 1])


def _lies(shown: tuple[int, int, int, int]) -> bool:
    """Tell whether a picture is stored lying on its side."""
    return shown[0] == 0


def _one_field(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Keep every second row and put the mean of its neighbours between."""
    out = image.copy()
    kept = image[::2]
    between = (kept[:-1].astype(np.uint16) + kept[1:]) // 2
    out[1::2][: len(between)] = between
    if len(out) % 2 == 0:
        out[-1] = out[-2]
    return out


def _resized(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    if image.shape[:2] == (height, width):
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)
