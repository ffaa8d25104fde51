"""The TUM RGB-D data set (Sturm et al., IROS 2012)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import PinholeCamera
from prgbd.io.naming import safe_name
from prgbd.io.text_tables import as_numbers
from prgbd.plugins.data._depth_files import DepthFormat
from prgbd.plugins.data._images import list_images, read_image
from prgbd.plugins.data._recording import Files, FileSequence, choose, existing_root, or_unpack
from prgbd.plugins.data._rgbd_layout import depth_of_images, own_seconds, read_list, sorted_by_time, true_poses

LEVELS_PER_METRE = 5000.0

# Published calibrations of the colour cameras; freiburg3 is undistorted already.
FAMILIES = {
    "freiburg1": PinholeCamera(
        640, 480, 517.306408, 516.469215, 318.643040, 255.313989, (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
    ),
    "freiburg2": PinholeCamera(
        640, 480, 520.908620, 521.007327, 325.141442, 249.701764, (0.231222, -0.784899, -0.003257, -0.000105, 0.917205)
    ),
    "freiburg3": PinholeCamera(640, 480, 535.433105, 539.212524, 320.106653, 247.632132),
}


class TumRgbdSequence(FileSequence):
    """One recording: ``rgb/``, ``depth/`` and ``groundtruth.txt``, with ``rgb.txt`` and ``depth.txt`` where present.

    Every colour image is a frame. Depth is the nearest depth image within 0.02 s (frames without one get a depth of 0
    everywhere), true poses are interpolated between the motion capture's. Times in
    another unit, or that count from the start, are recognised and said. Images and depth are undistorted.

    Args:
        root: The folder of one recording, or the folder above several.
        sequence: Name of the recording's folder. None takes the only one.
        family: ``freiburg1``, ``freiburg2`` or ``freiburg3``, which names the camera; None reads it off the name.
        depth_levels_per_metre: Grey levels in one metre of depth: 5000 in this data set, 1000 where a level is a
            millimetre.
        depth_invalid: Grey levels that mean "unknown"; 0 and 65535 always do.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If a file is absent or malformed.
    """

    def __init__(
        self,
        root: str | Path,
        sequence: str | None = None,
        family: str | None = None,
        depth_levels_per_metre: float = LEVELS_PER_METRE,
        depth_invalid: tuple[float, ...] = (0,),
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        base = existing_root(root)
        names = _names(base)
        chosen = choose(sequence, names, base)
        folder = names[chosen]
        camera = _camera(folder, family)
        times, images = _stamped(folder, "rgb")
        size = read_image(images[0]).shape
        if size[:2] != (camera.height, camera.width):
            raise DataError(
                f"{images[0]} is {size[1]}x{size[0]} pixels; the images of this data set are 640x480; "
                "for another camera take data=rgbd."
            )
        times = own_seconds(times, folder / "rgb")
        files = Files(images, times, poses=true_poses(folder / "groundtruth.txt", times))
        files.depth_format = DepthFormat(depth_levels_per_metre, depth_invalid)
        if (folder / "depth").is_dir():
            files.depths = depth_of_images(*_stamped(folder, "depth"), times, folder)
        super().__init__(safe_name(chosen), camera, files, start, stop, step)

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the recordings in ``root``.

        Raises:
            DataError: If there are none.
        """
        return list(_names(existing_root(options["root"])))


def _names(base: Path) -> dict[str, Path]:
    """Return the folders of the recordings by name."""
    if (base / "rgb").is_dir():
        return {base.resolve().name: base}
    found = {p.name: p for p in sorted(base.iterdir()) if (p / "rgb").is_dir()}
    if not found:
        mend = or_unpack(base, "check the option data.root")
        raise DataError(f"{base} is no recording and holds none (a folder with 'rgb'); {mend}.")
    return found


def _camera(folder: Path, family: str | None) -> PinholeCamera:
    if family is None:
        found = re.search(r"freiburg[123]", folder.resolve().name)
        if found is None:
            raise DataError(
                f"The name of {folder} does not tell its camera; set the option data.family to {', '.join(FAMILIES)}, "
                "or take data=rgbd with a camera.yaml for another camera."
            )
        family = found[0]
    if family not in FAMILIES:
        raise ConfigError(f"The option family is '{family}'; it must be one of {', '.join(FAMILIES)}.")
    return FAMILIES[family]


def _stamped(folder: Path, kind: str) -> tuple[NDArray[np.float64], list[Path]]:
    """Return the time stamps and files of ``rgb`` or ``depth`` in order of time."""
    listing = folder / f"{kind}.txt"
    if listing.is_file():
        return read_list(listing, kind)
    pairs = []
    for path in list_images(folder / kind):
        time = as_numbers([path.stem])
        if time is None or not np.isfinite(time[0]):
            raise DataError(f"The name of {path} is no time stamp, and there is no {listing}; add the list.")
        pairs.append((float(time[0]), path))
    return sorted_by_time(pairs)
