"""Reading image files, and the lists of them, with errors that name the file."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp")


def read_image(path: Path, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8 RGB; grey images get three equal channels.

    Args:
        path: The file.
        size: (width, height) that the image must have, pixels; None takes any.

    Raises:
        DataError: If the file is absent, truncated, no image, or of another size.
    """
    image = _decode(path, cv2.IMREAD_COLOR)
    _check_size(path, image, size)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def read_depth(path: Path, unit: float, size: tuple[int, int], invalid: tuple[int, ...] = (0,)) -> NDArray[np.float32]:
    """Read a 16-bit depth image as (H, W) float32 metres with 0 where unknown.

    Args:
        path: The file.
        unit: Metres per grey level.
        size: (width, height) that the image must have, pixels.
        invalid: Grey levels that mean "unknown".

    Raises:
        DataError: If the file is absent, truncated, of another size, or not 16-bit grey.
    """
    levels = _decode(path, cv2.IMREAD_UNCHANGED)
    if levels.ndim != 2 or levels.dtype != np.uint16:
        raise DataError(f"{path} is no 16-bit grey image, so it holds no depth; check the file.")
    _check_size(path, levels, size)
    depth = levels.astype(np.float32) * np.float32(unit)
    depth[np.isin(levels, invalid)] = 0.0
    return depth


def list_images(folder: Path) -> list[Path]:
    """Return the image files of a folder in natural order (2 before 10).

    Raises:
        DataError: If the folder is absent or has no image.
    """
    if not folder.is_dir():
        raise DataError(f"There is no folder {folder}; check the option data.root.")
    found = [p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")]
    if not found:
        raise DataError(
            f"The folder {folder} has no images ({', '.join(SUFFIXES[:3])}, ...); check the option data.root."
        )
    return sorted(found, key=lambda p: natural_key(p.name))


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares runs of digits by their number."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(p), p) if i % 2 else (1, 0, p) for i, p in enumerate(parts)]


def safe_name(text: str) -> str:
    """Return the text with everything replaced that does not belong into a file name."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text).strip("_.") or "recording"


def _decode(path: Path, flags: int) -> NDArray:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise DataError(f"There is no image {path}; the recording is not complete.") from None
    except OSError as error:
        raise DataError(f"The image {path} cannot be read ({error.strerror}); check the file.") from error
    image = None
    if data and not _is_cut(data):
        try:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:
            image = None
    if image is None:
        raise DataError(f"{path} is truncated or no image; copy the file anew or leave the frame out.")
    return image


def _is_cut(data: bytes) -> bool:
    """Tell whether a JPEG or PNG lacks its end; decoders fill the missing part with grey and stay silent."""
    if data.startswith(b"\xff\xd8"):
        # Entropy-coded data holds no markers, so the image's own end follows its last start of scan. (An embedded
        # thumbnail comes before.)
        return data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda") or b"\xff\xda" not in data
    if data.startswith(b"\x89PNG"):
        return b"IEND" not in data
    return False


def _check_size(path: Path, image: NDArray, size: tuple[int, int] | None) -> None:
    found = (image.shape[1], image.shape[0])
    if size is not None and found != tuple(size):
        raise DataError(
            f"{path} is {found[0]}x{found[1]} pixels, but the camera of the recording is {size[0]}x{size[1]}; "
            "check the calibration or leave the image out."
        )
