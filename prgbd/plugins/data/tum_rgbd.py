"""The TUM RGB-D data set (Sturm et al., IROS 2012)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import PinholeCamera
from prgbd.io.naming import safe_name
from prgbd.io.text_tables import read_table, text_lines
from prgbd.plugins.data._images import list_images, read_image
from prgbd.plugins.data._recording import Files, FileSequence, choose, existing_root, or_unpack

MAX_DIFFERENCE = 0.02  # seconds, as in the data set's own tools
MAX_GAP = 0.1  # seconds between two poses of the motion capture to interpolate over

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
    everywhere), true poses are interpolated between the motion capture's. Images and depth are undistorted.

    Args:
        root: The folder of one recording, or the folder above several.
        sequence: Name of the recording's folder. None takes the only one.
        family: ``freiburg1``, ``freiburg2`` or ``freiburg3``, which names the camera; None reads it off the name.
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
            raise DataError(f"{images[0]} is {size[1]}x{size[0]} pixels; the images of this data set are 640x480.")
        files = Files(images, times, poses=_poses(folder / "groundtruth.txt", times), depth_unit=1 / 5000)
        if (folder / "depth").is_dir():
            depth_times, depth_files = _stamped(folder, "depth")
            files.depths = [None if i < 0 else depth_files[i] for i in _partners(depth_times, times)]
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
                f"The name of {folder} does not tell its camera; set the option data.family to {', '.join(FAMILIES)}."
            )
        family = found[0]
    if family not in FAMILIES:
        raise ConfigError(f"The option family is '{family}'; it must be one of {', '.join(FAMILIES)}.")
    return FAMILIES[family]


def _stamped(folder: Path, kind: str) -> tuple[NDArray[np.float64], list[Path]]:
    """Return the time stamps and files of ``rgb`` or ``depth`` in order of time."""
    listing = folder / f"{kind}.txt"
    pairs = []
    if listing.is_file():
        for number, words in text_lines(listing, f"list of {kind} images"):
            if len(words) != 2 or not _is_number(words[0]):
                raise DataError(f"Line {number} of {listing} is not a time stamp and a file name; copy the file anew.")
            pairs.append((float(words[0]), folder / words[1]))
    else:
        for path in list_images(folder / kind):
            if not _is_number(path.stem):
                raise DataError(f"The name of {path} is no time stamp, and there is no {listing}; add the list.")
            pairs.append((float(path.stem), path))
    if not pairs:
        raise DataError(f"{listing} lists no images; copy the file anew.")
    pairs.sort(key=lambda pair: pair[0])
    return np.array([t for t, _ in pairs]), [p for _, p in pairs]


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _nearest(among: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return for each time the index of the nearest of the ascending times ``among``."""
    after = np.clip(np.searchsorted(among, times), 1, max(len(among) - 1, 1))
    if len(among) == 1:
        return np.zeros(len(times), np.int64)
    return np.where(times - among[after - 1] <= among[after] - times, after - 1, after).astype(np.int64)


def _partners(among: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return for each time the index of its partner in ``among`` within 0.02 s, or -1; a partner serves only once."""
    nearest = _nearest(among, times)
    difference = np.abs(among[nearest] - times)
    closest = np.full(len(among), np.inf)
    np.minimum.at(closest, nearest, difference)
    return np.where((difference <= MAX_DIFFERENCE) & (difference == closest[nearest]), nearest, -1)


def _poses(path: Path, times: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the true poses (N, 4, 4) at the given times, NaN in gaps of the motion capture; None without a file."""
    if not path.is_file():
        return None
    rows = read_table(path, 8, "time stamp, translation and quaternion")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    rows = rows[np.append(True, np.diff(rows[:, 0]) > 0)] if len(rows) else rows
    norm = np.linalg.norm(rows[:, 4:], axis=1)
    if not (np.isfinite(rows).all() and np.all(np.abs(norm - 1) < 0.05)):
        raise DataError(f"{path} has a pose that is not finite or whose quaternion is not of length 1; copy it anew.")
    out = np.full((len(times), 4, 4), np.nan)
    if len(rows) < 2:
        return None
    nearest = _nearest(rows[:, 0], times)
    after = np.clip(np.searchsorted(rows[:, 0], times, side="right"), 1, len(rows) - 1)
    gap = rows[after, 0] - rows[after - 1, 0]
    inside = (times >= rows[0, 0]) & (times <= rows[-1, 0])
    known = inside & (gap <= MAX_GAP) & (np.abs(rows[nearest, 0] - times) <= MAX_DIFFERENCE)
    if not known.any():
        return None
    at = times[known]
    out[known] = np.eye(4)
    out[known, :3, :3] = Slerp(rows[:, 0], Rotation.from_quat(rows[:, 4:]))(at).as_matrix()
    out[known, :3, 3] = np.stack([np.interp(at, rows[:, 0], rows[:, 1 + i]) for i in range(3)], axis=1)
    return out
