"""Reading image files, and the lists of them, with errors that name the file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.io.reading import require_file, visible
from prgbd.plugins.data._completeness import whole
from prgbd.plugins.data._levels import ALL_LEVELS, Levels, levels_of
from prgbd.plugins.data._order import natural_key

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp")
LOOKED_AT = 8  # images of a recording of more than 8 bits, for its range of values


def read_image(path: Path, size: tuple[int, int] | None = None, levels: Levels = ALL_LEVELS) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8 RGB; grey images get three equal channels.

    What cameras note in a JPEG of how they were held (EXIF) turns the image, transparency is left out, and of
    several pictures in one file the first is taken.

    Args:
        path: The file.
        size: (width, height) that the image must have, pixels; None takes any.
        levels: How values of more than 8 bits become 8.

    Raises:
        DataError: If the file is absent, truncated, no image, or of another size.
    """
    image = levels.to_8_bits(_colour(path))
    _check_size(path, image, size)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def common_levels(images: Sequence[Path]) -> tuple[Levels, str]:
    """Return how the values of a recording's images become 8 bits, and what was understood of them, in words.

    Nothing but the first image is read where it has 8 bits. Images that cannot be read are left to the run.

    Args:
        images: All images of the recording.
    """
    return levels_over(lambda index: _colour(images[index]), len(images))


def levels_over(read: Callable[[int], NDArray], count: int) -> tuple[Levels, str]:
    """Do as ``common_levels`` does for images that ``read`` returns by number, with the values that they have."""
    values: list[NDArray] = []
    for index in np.unique(np.linspace(0, count - 1, LOOKED_AT).astype(int)):
        with contextlib.suppress(DataError):
            values.append(read(int(index)))
        if values and values[0].dtype == np.uint8:
            break
    return levels_of(values)


def list_images(folder: Path) -> list[Path]:
    """Return the image files of a folder in natural order (2 before 10).

    Raises:
        DataError: If the folder is absent or has no image.
    """
    if not folder.is_dir():
        raise DataError(f"There is no folder {folder}; check the option data.root.")
    found = visible(folder, SUFFIXES)
    if not found:
        raise DataError(
            f"The folder {folder} has no images ({', '.join(SUFFIXES[:3])}, ...); check the option data.root."
        )
    return sorted(found, key=lambda path: natural_key(path.name))


def _colour(path: Path) -> NDArray:
    """Return an image as (H, W, 3) BGR values of the type that the file has."""
    return colour(_content(path), path)


def colour(data: bytes, where: Path | str) -> NDArray:
    """Return the content of an image file as (H, W, 3) BGR values of the type that it has.

    Raises:
        DataError: If it is truncated or no image; ``where`` names it.
    """
    image = decoded(data, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH, where)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image[..., :3]


def decode_file(path: Path, flags: int) -> NDArray:
    """Return the pixels of an image file as OpenCV's flags ask for them.

    Raises:
        DataError: If the file is absent, truncated or no image.
    """
    return decoded(_content(path), flags, path)


def decoded(data: bytes, flags: int, where: Path | str) -> NDArray:
    """Do as ``decode_file`` does for the content of a file; ``where`` names it.

    Raises:
        DataError: If it is truncated or no image.
    """
    complete, image = whole(data), None
    if complete:
        try:
            image = cv2.imdecode(np.frombuffer(complete, np.uint8), flags)
            if image is None:  # grey images of floats have no three channels
                image = cv2.imdecode(np.frombuffer(complete, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            image = None
    if image is None:
        raise DataError(f"{where} is truncated or no image; copy the file anew or leave the frame out.")
    return image


def _content(path: Path) -> bytes:
    try:
        return require_file(path, "an image of the recording").read_bytes()
    except OSError as error:
        raise DataError(f"The image {path} cannot be read ({error.strerror}); check the file.") from error


def _check_size(path: Path, image: NDArray, size: tuple[int, int] | None) -> None:
    found = (image.shape[1], image.shape[0])
    if size is not None and found != tuple(size):
        raise DataError(
            f"{path} is {found[0]}x{found[1]} pixels, but the camera of the recording is {size[0]}x{size[1]}; "
            "check the calibration or leave the image out."
        )
