"""Any recording of a colour and a depth camera that look at the same."""

from __future__ import annotations

import glob
import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.option_ranges import Positive
from prgbd.io.naming import safe_name
from prgbd.io.reading import visible
from prgbd.plugins.data import _depth_files, _images
from prgbd.plugins.data._camera import known_or_estimated
from prgbd.plugins.data._depth_files import DepthFormat
from prgbd.plugins.data._order import in_order
from prgbd.plugins.data._recording import Files, FileSequence, choose, existing_root, frame_range, or_unpack
from prgbd.plugins.data._rgbd_layout import (
    depth_of_images,
    own_seconds,
    read_associations,
    read_list,
    true_poses,
    warn_if_few,
)

log = logging.getLogger("prgbd")

DEFAULT_RATE = 30.0  # frames per second
CAMERA = "camera.yaml"
ASSOCIATIONS = ("associations.txt", "associated.txt", "associate.txt")


class RgbdSequence(FileSequence):
    """Colour images and depth registered to them, with a camera file: TUM's layout, or two folders of any names.

    Colour and depth find each other by a list of pairs (``associations.txt``), by lists of times (``rgb.txt`` and
    ``depth.txt``, named as the folders are), by the times in their names, by the numbers in them, or by their order
    where there are as many of one as of the other. Depth is PNG, TIFF, NPY or EXR. True poses are those of
    ``groundtruth.txt`` in TUM's format. Images and depth are undistorted.

    Args:
        root: The folder of one recording, or the folder above several.
        sequence: Name of the recording's folder. None takes the only one.
        rgb: The folder of the colour images within the recording, or a pattern such as ``frames/*_color.jpg``.
        depth: The folder or the pattern of the depth files likewise.
        camera: A YAML file (``camera: {width, height, fx, fy, cx, cy, distortion}`` or ``fov_degrees``) or its content,
            of the colour images; None takes ``camera.yaml`` in the recording or in ``root``.
        fov: Horizontal field of view in degrees, instead of ``camera``.
        fps: Frames per second where nothing tells the times; None takes 30.
        depth_levels_per_metre: Grey levels in one metre of depth: 1000 where a level is a millimetre, 5000 in TUM's
            files. None takes whole numbers as millimetres and others as metres.
        depth_invalid: Values that mean "unknown"; 0, the largest value of the type, NaN and what is negative always do.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If a file is absent or malformed, or colour and depth do not find each other.
    """

    def __init__(
        self,
        root: str | Path,
        sequence: str | None = None,
        rgb: str = "rgb",
        depth: str = "depth",
        camera: str | Path | Mapping[str, Any] | None = None,
        fov: float | None = None,
        fps: Positive | None = None,
        depth_levels_per_metre: Positive | None = None,
        depth_invalid: tuple[float, ...] = (0,),
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        form = DepthFormat(depth_levels_per_metre, depth_invalid)
        base = existing_root(root)
        names = _names(base, rgb)
        chosen = choose(sequence, names, base)
        folder = names[chosen]
        images, times, depths = _paired(folder, rgb, depth, fps)
        span = frame_range(len(images), start, stop, step, folder.name)
        beside = next(
            (f for f in (folder / "camera.yaml", base / "camera.yaml") if f.is_file()), folder / "camera.yaml"
        )
        pinhole = known_or_estimated(
            camera, fov, beside, folder, lambda i: _images.read_image(images[span[i]]), len(span)
        )
        files = Files(images, times, depths, poses=true_poses(folder / "groundtruth.txt", times), depth_format=form)
        super().__init__(safe_name(chosen), pinhole, files, start, stop, step)

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the recordings in ``root``.

        Raises:
            DataError: If there are none.
        """
        return list(_names(existing_root(options["root"]), options.get("rgb", "rgb")))


def _names(base: Path, rgb: str) -> dict[str, Path]:
    """Return the folders of the recordings by name."""
    if _found(base, rgb):
        return {base.resolve().name: base}
    found = {path.name: path for path in visible(base) if path.is_dir() and _found(path, rgb)}
    if not found:
        mend = or_unpack(base, "check the options data.root and data.rgb")
        raise DataError(f"{base} is no recording and holds none (with colour images in '{rgb}'); {mend}.")
    return found


def _found(folder: Path, where: str, suffixes: tuple[str, ...] = _images.SUFFIXES) -> list[Path]:
    """Return the files of a folder within the recording, or of a pattern."""
    if not where or Path(where).is_absolute():
        raise ConfigError(f"'{where}' is no folder or pattern within a recording; set data.rgb and data.depth to such.")
    if glob.has_magic(where):
        matched = (Path(path) for path in glob.iglob(str(Path(glob.escape(str(folder))) / where)))
        return sorted(path for path in matched if path.suffix.lower() in suffixes and path.is_file())
    return visible(folder / where, suffixes) if (folder / where).is_dir() else []


def _paired(
    folder: Path, rgb: str, depth: str, fps: float | None
) -> tuple[list[Path], NDArray[np.float64], list[Path | None]]:
    """Return the colour images in order, their times in seconds, and the depth file of each."""
    listed = next((folder / name for name in ASSOCIATIONS if (folder / name).is_file()), None)
    if listed is not None:
        times, images, depths = read_associations(listed, depth)
        return images, own_seconds(times, listed), list(depths)
    images, own = _listed_or_found(folder, rgb, _images.SUFFIXES)
    files, their = _listed_or_found(folder, depth, _depth_files.SUFFIXES)
    if own is not None and their is not None:
        own = own_seconds(own, folder / rgb)
        return images, own, depth_of_images(their, files, own, folder)
    if own is None:
        own = in_order(images).timestamps(fps, DEFAULT_RATE)
    return images, own, _by_names(folder, images, files)


def _by_names(folder: Path, images: list[Path], files: list[Path]) -> list[Path | None]:
    """Return the depth file of each image by the numbers in their names, or else by their order.

    Raises:
        DataError: If neither tells.
    """
    by_name = {_key(path): path for path in files}
    partners = [by_name.get(_key(path)) for path in images]
    if len(by_name) == len(files) and any(partners) and len({_key(path) for path in images}) == len(images):
        warn_if_few(partners, folder)
        return partners
    if len(images) != len(files):
        raise DataError(
            f"{folder} has {len(images)} colour images and {len(files)} depth files without common names or times; "
            f"list the pairs in {ASSOCIATIONS[0]} (time, image, time, depth)."
        )
    log.warning(
        "Colour and depth of %s are paired by their order alone: %s with %s.", folder, images[0].name, files[0].name
    )
    return list(files)


def _key(path: Path) -> tuple[int, ...] | str:
    """Return the numbers of a file's name, so that 0001_colour.png is the partner of 1_depth.png."""
    return tuple(int(digits) for digits in re.findall(r"[0-9]+", path.stem)) or path.stem


def _listed_or_found(
    folder: Path, where: str, suffixes: tuple[str, ...]
) -> tuple[list[Path], NDArray[np.float64] | None]:
    """Return files in order, and their times where a list or their names tell them."""
    listing = folder / f"{where}.txt"
    if not glob.has_magic(where) and listing.is_file():
        times, files = read_list(listing, where)
        return files, times
    found = _found(folder, where, suffixes)
    if not found:
        raise DataError(
            f"There are no {', '.join(suffixes[:4])} files in {folder / where}; check data.rgb and data.depth."
        )
    order = in_order(found)
    return order.images, order.times
