"""Small videos written by tests, whose pictures tell their numbers."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

WIDTH, HEIGHT = 128, 64
BITS = 8


def coded(number: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """An RGB image with its number in 8 blocks along the top, light where a bit is set, and grey below."""
    image = np.full((height, width, 3), 90, np.uint8)
    for bit in range(BITS):
        image[: height // 3, bit * width // BITS : (bit + 1) * width // BITS] = 230 if number >> bit & 1 else 20
    return image


def number_of(image: np.ndarray) -> int:
    """The number of a coded image; -1 if it does not stand upright."""
    height, width = image.shape[:2]
    if not 60 < image[-height // 4 :].mean() < 120:
        return -1
    row = image[height // 6]
    return sum(int(row[(2 * bit + 1) * width // (2 * BITS)].mean() > 127) << bit for bit in range(BITS))


def film(
    path: Path,
    images: Iterable[np.ndarray],
    codec: str = "libx264",
    *,
    stamps: Iterable[int] | None = None,
    base: Fraction = Fraction(1, 1000),
    pixels: str = "yuv420p",
    aspect: Fraction | None = None,
    rotation: int | None = None,
    container: dict[str, str] | None = None,
    **options: Any,
) -> Path:
    """Write a video and return its path.

    Args:
        path: Its suffix chooses the container.
        images: (H, W, 3) uint8 RGB.
        codec: FFmpeg's encoder.
        stamps: Time stamp of each image in units of ``base``; None takes 30 images a second.
        base: Seconds.
        pixels: FFmpeg's pixel format.
        aspect: Width over height of a sample.
        rotation: Degrees by which players turn the picture anticlockwise.
        container: Options of the container.
        options: Options of the encoder.
    """
    with av.open(str(path), "w", options=container or {}) as file:
        stream: Any = file.add_stream(codec, rate=30, options={key: str(value) for key, value in options.items()})
        stream.codec_context.time_base = base
        stream.pix_fmt = pixels
        times = iter(stamps) if stamps is not None else (round(i / 30 / base) for i in range(1 << 20))
        for number, image in enumerate(images):
            if number == 0:
                stream.height, stream.width = image.shape[:2]
                if aspect is not None:
                    stream.codec_context.sample_aspect_ratio = aspect
                if rotation is not None:
                    stream.set_display_rotation(rotation)
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), "rgb24").reformat(format=pixels)
            frame.pts, frame.time_base = next(times), base
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def replace_box(data: bytes, path: tuple[bytes, ...], content: bytes) -> bytes:
    """Replace the content of a box of an MP4 file; the boxes around it grow with it."""
    out, at = b"", 0
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        inner = data[at + 8 : at + length]
        if data[at + 4 : at + 8] == path[0]:
            inner = replace_box(inner, path[1:], content) if len(path) > 1 else content
        out += struct.pack(">I", len(inner) + 8) + data[at + 4 : at + 8] + inner
        at += length
    return out
