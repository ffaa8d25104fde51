"""Any folder of images as a recording."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.plugins.data._camera import known_or_estimated
from prgbd.plugins.data._images import SUFFIXES, list_images, read_image, safe_name
from prgbd.plugins.data._recording import Files, FileSequence, choose, existing_root, frame_range

MOST_DIGITS = 8  # of a frame number; longer numbers are times in some unit, or dates


class ImagesSequence(FileSequence):
    """A folder of images in natural order of their names.

    Where the names end in numbers that ascend, their times follow from them, so that a gap in the numbers is a gap in
    time; else all images are equally far apart.

    Args:
        root: The folder of the images, or a folder with several such folders.
        sequence: Name of the folder within ``root``; None for the images in ``root`` itself or its only folder.
        camera: A YAML file (``camera: {width, height, fx, fy, cx, cy, distortion}`` or ``fov_degrees``) or its content;
            None takes ``camera.yaml`` beside the images; where there is none, COLMAP estimates it (extra ``colmap``).
        fov: Horizontal field of view in degrees, instead of ``camera``.
        fps: Frames per second.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If the folder is absent or empty, or the camera file is malformed.
    """

    def __init__(
        self,
        root: str | Path,
        sequence: str | None = None,
        camera: str | Path | Mapping[str, Any] | None = None,
        fov: float | None = None,
        fps: float = 30.0,
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        if not (np.isfinite(fps) and fps > 0):
            raise ConfigError(f"The option fps is {fps}; it must be positive.")
        base = existing_root(root)
        names = _names(base)
        folder = (
            base if names == [None] and sequence is None else base / choose(sequence, [n for n in names if n], base)
        )
        images = list_images(folder)
        chosen = frame_range(len(images), start, stop, step, folder.name)
        span = range(chosen[0], chosen[-1] + 1)
        pinhole = known_or_estimated(
            camera, fov, folder / "camera.yaml", folder, lambda i: read_image(images[span[i]]), len(span)
        )
        files = Files(images, _counts(images) / fps)
        super().__init__(safe_name(folder.resolve().name), pinhole, files, start, stop, step)

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the folders of images in ``root``, or ``[None]`` if the images are in ``root`` itself.

        Raises:
            DataError: If there are none.
        """
        return _names(existing_root(options["root"]))


def _counts(images: list[Path]) -> NDArray[np.float64]:
    """Return how many frames after the first each image is, by the numbers in the names where they say so."""
    found = [re.search(r"(\d+)$", path.stem) for path in images]
    numbers = np.array([int(match[1]) if match and len(match[1]) <= MOST_DIGITS else -1 for match in found])
    steps = np.diff(numbers)
    if not len(steps) or numbers.min() < 0 or steps.min() < 1:
        return np.arange(len(images), dtype=np.float64)
    return (numbers - numbers[0]) / float(np.median(steps))


def _names(base: Path) -> list[str | None]:
    def has_images(folder: Path) -> bool:
        return any(p.suffix.lower() in SUFFIXES for p in folder.iterdir())

    if has_images(base):
        return [None]
    found = sorted(p.name for p in base.iterdir() if p.is_dir() and has_images(p))
    if not found:
        raise DataError(
            f"The folder {base} has no images ({', '.join(SUFFIXES[:3])}, ...); check the option data.root."
        )
    return list(found)
