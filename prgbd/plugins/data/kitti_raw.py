"""The KITTI raw recordings (Geiger et al., IJRR 2013) in their published layout, with the Eigen split."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.text_tables import text_lines
from prgbd.plugins.data._camera import plausible
from prgbd.plugins.data._images import list_images, read_image
from prgbd.plugins.data._kitti_calibration import camera_poses, read_day, read_scan, velodyne_depth
from prgbd.plugins.data._recording import Files, FileSequence, check_index, choose, existing_root, or_unpack

CAMERAS = {"color": {"left": (2, 3), "right": (3, 3)}, "gray": {"left": (0, 1), "right": (1, 1)}}
SIDES = ("left", "right")
TRUTHS = ("velodyne", "camera")
RATE = 10.0  # Hz, of recordings without timestamps.txt


class KittiRawSequence(FileSequence):
    """One drive: ``root/DATE/DATE_drive_NNNN_sync/{image_02, velodyne_points, oxts}`` with the day's calibration.

    Where there are scans of the velodyne they are the true depth (not a sensor's: frames have none); where there is
    ``oxts``, poses come from it. Time stamps are those of the images, or 10 Hz by the frames' numbers.

    Args:
        root: The folder that holds the days (``2011_09_26``, ...).
        sequence: ``2011_09_26_drive_0001_sync``; the day before it and the ``_sync`` after it may be left out or in.
        camera: ``color`` (image_02, image_03), ``gray`` (image_00, image_01), or ``auto``: colour where there is some.
        side: ``left`` or ``right`` camera of the pair.
        split: A published split file with lines ``DATE/DRIVE FRAME SIDE``, such as Monodepth2's
            ``splits/eigen/test_files.txt``: only its drives, and of these only its frames of this side. None takes all.
        truth: ``velodyne`` gives the distance in front of the velodyne as true depth, as the published evaluation of
            the Eigen split does; ``camera`` gives the camera's z.
        start: First frame, after the split.
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
        camera: str = "auto",
        side: str = "left",
        split: str | Path | None = None,
        truth: str = "velodyne",
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        if truth not in TRUTHS:
            raise ConfigError(f"The option truth is '{truth}'; it must be {' or '.join(TRUTHS)}.")
        drives = _drives(root, split, side)
        name = choose(_completed(sequence, drives), drives, Path(root))
        folder = drives[name]
        number, right = _cameras(folder, camera, side)
        images = _listed_images(folder, number, None if split is None else _split(Path(split), side)[name], split)
        self._day = read_day(folder.parent, number, right)
        P, calibration = self._day.P, folder.parent / "calib_cam_to_cam.txt"
        height, width = read_image(images[0]).shape[:2]
        intrinsics = (float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
        files = Files(images, _timestamps(folder / f"image_{number:02d}", images))
        files.poses = camera_poses([_existing(folder / "oxts" / "data" / f"{p.stem}.txt") for p in images], self._day)
        if number != right:
            rights = [_existing(folder / f"image_{right:02d}" / "data" / image.name) for image in images]
            if any(rights) and self._day.baseline is not None:
                files.rights, self.baseline = rights, self._day.baseline
        super().__init__(name, plausible(width, height, intrinsics, (), str(calibration)), files, start, stop, step)
        self._forward = truth == "velodyne"
        self._scans = [
            _existing(folder / "velodyne_points" / "data" / f"{image.stem}.bin") for image in self._files.images
        ]
        if any(self._scans) and self._day.rTv is None:
            raise DataError(f"There is no {folder.parent / 'calib_velo_to_cam.txt'}; the scans need it for true depth.")

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the drives in ``root``, those of the split where one is given.

        Raises:
            DataError: If there are none.
        """
        return list(_drives(options["root"], options.get("split"), options.get("side", "left")))

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Return sparse true depth from the velodyne, (H, W) float32 metres with 0 where unknown, or None.

        Raises:
            DataError: If the scan cannot be read; the message names it.
        """
        check_index(index, len(self), self.name)
        path = self._scans[index]
        if path is None:
            return None
        return velodyne_depth(read_scan(path), self._day, self.camera.width, self.camera.height, self._forward)


def _drives(root: str | Path, split: str | Path | None, side: str) -> dict[str, Path]:
    """The folders of the drives by name; with a split those that it lists and that are there."""
    if side not in SIDES:
        raise ConfigError(f"The option side is '{side}'; it must be left or right.")
    path = existing_root(root)
    found = {folder.name: folder for folder in sorted(path.glob("*/*_drive_*")) if any(folder.glob("image_0?/data"))}
    if not found:
        mend = or_unpack(path, "set data.root to the folder that holds the days")
        raise DataError(f"{path} has no drives such as 2011_09_26/2011_09_26_drive_0001_sync with images; {mend}.")
    unrectified = [name for name in found if name.endswith("_extract")]
    if len(unrectified) == len(found):
        raise DataError(
            f"{found[unrectified[0]]} is not rectified, and the calibration is that of rectified images; download the "
            "drive as 'synced+rectified data'."
        )
    found = {name: folder for name, folder in found.items() if name not in unrectified}
    if split is None:
        return found
    wanted = _split(Path(split), side)
    kept = {name: folder for name, folder in found.items() if name in wanted}
    if not kept:
        raise DataError(f"{path} has none of the {len(wanted)} drives that {split} lists (such as {min(wanted)}).")
    return kept


def _split(path: Path, side: str) -> dict[str, list[int]]:
    """The frame numbers of one side by drive, ascending and each once."""
    frames: dict[str, set[int]] = {}
    for number, words in text_lines(path, "split"):
        if len(words) != 3 or not words[1].isdigit() or words[2] not in ("l", "r"):
            raise DataError(
                f"Line {number} of {path} is not 'DATE/DRIVE FRAME l' or '... r'; use a published split file."
            )
        if words[2] == side[0]:
            frames.setdefault(words[0].rsplit("/", 1)[-1], set()).add(int(words[1]))
    if not frames:
        raise DataError(f"The split {path} lists no frame of the {side} camera; check data.split and data.side.")
    return {name: sorted(numbers) for name, numbers in frames.items()}


def _completed(sequence: str | None, drives: dict[str, Path]) -> str | None:
    """The full name of a drive that was written with its day in front or without ``_sync``."""
    if sequence is None:
        return None
    name = str(sequence).rstrip("/").rsplit("/", 1)[-1]
    return name if name in drives or f"{name}_sync" not in drives else f"{name}_sync"


def _cameras(folder: Path, camera: str, side: str) -> tuple[int, int]:
    if camera not in ("auto", *CAMERAS):
        raise ConfigError(f"The option camera is '{camera}'; it must be auto, color or gray.")
    if camera == "auto":
        colour = folder / f"image_{CAMERAS['color'][side][0]:02d}" / "data"
        camera = "color" if colour.is_dir() and any(colour.iterdir()) else "gray"
    number = CAMERAS[camera][side][0]
    other = SIDES[1 - SIDES.index(side)]
    if not (folder / f"image_{number:02d}").is_dir() and (folder / f"image_0{CAMERAS['color'][other][0]}").is_dir():
        raise DataError(f"{folder} has images of the {other} colour camera alone; set data.side={other}.")
    return CAMERAS[camera][side]


def _listed_images(folder: Path, number: int, frames: list[int] | None, split: str | Path | None) -> list[Path]:
    """The images of a camera; those of a split must all be there."""
    images = list_images(folder / f"image_{number:02d}" / "data")
    wrong = [path for path in images if not path.stem.isdigit()]
    if wrong:
        raise DataError(f"The name of {wrong[0]} is no frame number such as 0000000000.png; rename or remove it.")
    if frames is None:
        return images
    by_number = {int(path.stem): path for path in images}
    absent = [frame for frame in frames if frame not in by_number]
    if absent:
        raise DataError(
            f"{images[0].parent} lacks {len(absent)} of the {len(frames)} frames that {split} lists (such as "
            f"{absent[0]:010d}); complete the drive."
        )
    return [by_number[frame] for frame in frames]


def _timestamps(folder: Path, images: list[Path]) -> NDArray[np.float64]:
    """Seconds since the first frame of the drive."""
    numbers = [int(path.stem) for path in images]
    path = folder / "timestamps.txt"
    if not path.is_file():
        return np.array(numbers) / RATE
    seconds = []
    for line, words in text_lines(path, "time stamps"):
        try:
            whole, _, fraction = words[1].partition(".")
            moment = datetime.fromisoformat(f"{words[0]}T{whole}+00:00").timestamp()
            seconds.append((moment, float(f"0.{fraction or 0}")))
        except (IndexError, ValueError):
            raise DataError(
                f"Line {line} of {path} is no time such as 2011-09-26 13:02:25.964; copy it anew."
            ) from None
    if len(seconds) <= max(numbers):
        raise DataError(f"{path} has {len(seconds)} lines, but there is an image {max(numbers):010d}; copy it anew.")
    # The whole seconds first: a time since 1970 has too few digits left for nanoseconds.
    first = seconds[0]
    times = np.array([(moment - first[0]) + (fraction - first[1]) for moment, fraction in seconds])
    return times[numbers]


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None
