"""Any folder of images as a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.naming import safe_name
from prgbd.io.reading import visible
from prgbd.plugins.data._camera import known_or_estimated
from prgbd.plugins.data._images import SUFFIXES, list_images, read_image
from prgbd.plugins.data._order import in_order
from prgbd.plugins.data._recording import Files, FileSequence, choose, existing_root, frame_range
from prgbd.plugins.data._times import read_times

DEFAULT_RATE = 30.0  # frames per second


class ImagesSequence(FileSequence):
    """A folder of images in the order of their names.

    Names that are those of a clock (``str(time.time())``, nanoseconds, dates with a time of day) give order and times.
    Otherwise the order is natural (2 before 10), and where the names have a number that ascends, a gap in it is a gap
    in time; else all images are equally far apart.

    Args:
        root: The folder of the images, or a folder with several such folders.
        sequence: Name of the folder within ``root``; None for the images in ``root`` itself or its only folder.
        camera: A YAML file (``camera: {width, height, fx, fy, cx, cy, distortion}`` or ``fov_degrees``) or its content;
            None takes ``camera.yaml`` beside the images; where there is none, COLMAP estimates it (extra ``colmap``).
        fov: Horizontal field of view in degrees, instead of ``camera``.
        fps: Frames per second; None takes the times of the names, and 30 where they tell none.
        times: A file with the time of every image, which is taken instead of what the names say: a time a line, or
            times and file names, as TUM's ``rgb.txt`` and EuRoC's ``data.csv`` have them. It is sought in the folder
            of the images first.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.
        repeats: What happens to frames that repeat the one before, "leave_out" or "keep".

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
        fps: float | None = None,
        times: str | Path | None = None,
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
        repeats: Literal["leave_out", "keep"] = "leave_out",
    ) -> None:
        if fps is not None and not (np.isfinite(fps) and fps > 0):
            raise ConfigError(f"The option data.fps is {fps}; it must be positive.")
        if fps is not None and times is not None:
            raise ConfigError(
                "The options data.fps and data.times both tell the times of the images; give one of them."
            )
        base = existing_root(root)
        names = _names(base)
        folder = (
            base if names == [None] and sequence is None else base / choose(sequence, [n for n in names if n], base)
        )
        images, stamps, said = _timed(list_images(folder), fps, times)
        chosen = frame_range(len(images), start, stop, step, folder.name)
        span = range(chosen[0], chosen[-1] + 1)
        pinhole = known_or_estimated(
            camera, fov, folder / "camera.yaml", folder, lambda i: read_image(images[span[i]]), len(span)
        )
        self.remarks = (said,) if said else ()
        super().__init__(safe_name(folder.resolve().name), pinhole, Files(images, stamps), start, stop, step)
        self.leave_out_repeats(repeats)

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the folders of images in ``root``, or ``[None]`` if the images are in ``root`` itself.

        Raises:
            DataError: If there are none.
        """
        return _names(existing_root(options["root"]))


def _timed(
    images: list[Path], fps: float | None, times: str | Path | None
) -> tuple[list[Path], NDArray[np.float64], str]:
    """Return the images in order, their times in seconds, and what was understood, for the user."""
    if times is not None:
        beside = images[0].parent / times  # several recordings may have a file each
        return *read_times(beside if beside.is_file() else Path(times).expanduser(), images), f"times from {times}"
    order = in_order(images)
    return order.images, order.timestamps(fps, DEFAULT_RATE), order.words


def _names(base: Path) -> list[str | None]:
    def has_images(folder: Path) -> bool:
        return bool(visible(folder, SUFFIXES))

    if has_images(base):
        return [None]
    found = [p.name for p in visible(base) if p.is_dir() and has_images(p)]
    if not found:
        raise DataError(
            f"The folder {base} has no images ({', '.join(SUFFIXES[:3])}, ...); check the option data.root."
        )
    return list(found)
