"""The KITTI odometry data set (Geiger et al., CVPR 2012) in its published layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.text_tables import read_table, text_lines
from prgbd.plugins.data._camera import plausible
from prgbd.plugins.data._images import list_images, read_image
from prgbd.plugins.data._recording import (
    Files,
    FileSequence,
    as_poses,
    choose,
    existing_root,
    or_unpack,
)

CAMERAS = {"color": (2, 3), "gray": (0, 1)}


class KittiOdometrySequence(FileSequence):
    """One sequence: ``root/sequences/XX/{image_N, calib.txt, times.txt}`` and, where known, ``root/poses/XX.txt``.

    The published poses are those of camera 0; for the colour camera they are moved by its offset (about 6 cm), so
    ``poses`` always belongs to the images. Right images come with the frames that have one.

    Attributes:
        c0Tc: (4, 4) metres; maps the coordinates of the camera that is used to those of camera 0.

    Args:
        root: The folder that holds ``sequences`` and ``poses`` (or ``dataset`` with them).
        sequence: For example ``"00"``; a number works too. None takes the only one.
        camera: ``color`` (image_2, image_3), ``gray`` (image_0, image_1) or ``auto``: colour where there is some.
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
        sequence: str | int | None = None,
        camera: str = "auto",
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        base = _base(root)
        name = choose(_padded(sequence), _names(base), base)
        folder = base / "sequences" / name
        _check_complete(folder)
        left, right = _cameras(folder, camera)
        images = list_images(folder / f"image_{left}")
        numbers = [_number(path) for path in images]
        matrices = _calibration(folder / "calib.txt", (0, left, right))
        height, width = read_image(images[0]).shape[:2]
        P = matrices[left]
        intrinsics = (float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
        pinhole = plausible(width, height, intrinsics, (), str(folder / "calib.txt"))
        times = _times(folder / "times.txt", numbers)
        poses = _poses(base / "poses" / f"{name}.txt", len(times))
        files = Files(images, times[numbers])
        self.c0Tc = _offset(matrices[0], P)
        if poses is not None:
            files.poses = poses[numbers] @ self.c0Tc
        right_folder = folder / f"image_{right}"
        rights = [path if (path := right_folder / image.name).is_file() else None for image in images]
        if any(rights):
            files.rights = rights
            self.baseline = _baseline(P, matrices.get(right), folder / "calib.txt", right)
        super().__init__(name, pinhole, files, start, stop, step)

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the sequences in ``root`` that have images.

        Raises:
            DataError: If there are none.
        """
        return list(_names(_base(options["root"])))


def _base(root: str | Path) -> Path:
    path = existing_root(root)
    for base in (path, path / "dataset"):
        if (base / "sequences").is_dir():
            return base
    mend = or_unpack(path, "set data.root to the folder that holds 'sequences' and 'poses'")
    raise DataError(f"{path} has no folder 'sequences'; {mend}.")


def _names(base: Path) -> list[str]:
    found = [p.name for p in (base / "sequences").iterdir() if any((p / f"image_{n}").is_dir() for n in (0, 2))]
    if not found:
        raise DataError(
            f"{base / 'sequences'} has no sequence with a folder image_0 or image_2; check the option data.root."
        )
    return sorted(found)


def _check_complete(folder: Path) -> None:
    """The images and the two text files of a sequence are downloads of their own, so one is easily forgotten."""
    absent = [file for file in ("calib.txt", "times.txt") if not (folder / file).is_file()]
    if absent:
        raise DataError(
            f"There is no file {folder / absent[0]}; it comes with the data set's calibration files "
            "(data_odometry_calib.zip), see python -m prgbd.tools prepare kitti_odometry."
        )


def _padded(sequence: str | int | None) -> str | None:
    """YAML turns 00 into a number; names have two digits."""
    if sequence is None:
        return None
    text = str(sequence)
    return text.zfill(2) if text.isdigit() else text


def _cameras(folder: Path, camera: str) -> tuple[int, int]:
    if camera not in ("auto", *CAMERAS):
        raise ConfigError(f"The option camera is '{camera}'; it must be auto, color or gray.")
    if camera == "auto":
        colour = folder / f"image_{CAMERAS['color'][0]}"
        camera = "color" if colour.is_dir() and any(colour.iterdir()) else "gray"
    return CAMERAS[camera]


def _number(path: Path) -> int:
    if not path.stem.isdigit():
        raise DataError(f"The name of {path} is no frame number such as 000000.png; rename or remove it.")
    return int(path.stem)


def _calibration(path: Path, needed: tuple[int, int, int]) -> dict[int, NDArray[np.float64]]:
    """Return the projection matrices (3, 4) by camera; the right camera's may be absent."""
    matrices: dict[int, NDArray[np.float64]] = {}
    for _, words in text_lines(path, "calibration"):
        key = words[0].rstrip(":")
        if key not in (f"P{n}" for n in needed):
            continue
        try:
            values = np.array([float(word) for word in words[1:]])
        except ValueError:
            values = np.zeros(0)
        if values.size != 12 or not np.isfinite(values).all():
            raise DataError(f"The line {key} of {path} is not 12 finite numbers; copy the file anew.")
        matrices[int(key[1:])] = values.reshape(3, 4)
    for n in needed[:2]:
        if n not in matrices:
            raise DataError(f"{path} has no line P{n}; it must hold the rectified projection matrices P0 to P3.")
        if min(matrices[n][0, 0], matrices[n][1, 1]) <= 0:
            raise DataError(f"The line P{n} of {path} has a focal length that is not positive; copy the file anew.")
    return matrices


def _times(path: Path, numbers: list[int]) -> NDArray[np.float64]:
    times = read_table(path, 1, "time stamps")[:, 0]
    if len(times) <= max(numbers):
        raise DataError(f"{path} has {len(times)} time stamps, but there is an image {max(numbers):06d}; copy it anew.")
    return times


def _poses(path: Path, frames: int) -> NDArray[np.float64] | None:
    if not path.is_file():
        return None
    poses = as_poses(read_table(path, 12, "poses"), path)
    if len(poses) != frames:
        raise DataError(f"{path} has {len(poses)} poses, but times.txt has {frames} frames; copy the files anew.")
    return poses


def _offset(P0: NDArray[np.float64], P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``c0Tc``, (4, 4): where a rectified camera stands as seen from camera 0."""
    out = np.eye(4)
    out[:3, 3] = np.linalg.solve(P0[:, :3], P0[:, 3]) - np.linalg.solve(P[:, :3], P[:, 3])
    return out


def _baseline(P: NDArray[np.float64], P_right: NDArray[np.float64] | None, path: Path, number: int) -> float:
    if P_right is None:
        raise DataError(f"{path} has no line P{number}, although there are right images; copy it anew.")
    baseline = float((P[0, 3] - P_right[0, 3]) / P[0, 0])
    if baseline <= 0:
        raise DataError(f"{path} places the right camera {baseline:g} m right of the left one; copy it anew.")
    return baseline
