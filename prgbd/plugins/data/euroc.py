"""The EuRoC MAV data set (Burri et al., IJRR 2016), and other recordings in its layout, that of ETH's ASL."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.io.naming import safe_name
from prgbd.io.reading import read_text
from prgbd.io.text_tables import read_table
from prgbd.plugins.data._camera import camera_from_values
from prgbd.plugins.data._camera_files import read_camera_file
from prgbd.plugins.data._images import read_image
from prgbd.plugins.data._recording import Files, FileSequence, as_poses, choose, existing_root, or_unpack
from prgbd.plugins.data._rectification import Rectification
from prgbd.plugins.data._rgbd_layout import poses_at, read_list

NANOSECONDS = 1e-9
AT_ONCE = 0.001  # seconds that the two images of a stereo pair may be apart: one signal triggers both cameras
TRUTH = "state_groundtruth_estimate0"
TRUE_STATE = (0, 1, 2, 3, 5, 6, 7, 4)  # columns of time, position and quaternion x, y, z, w (the file has w first)


class EurocSequence(FileSequence):
    """One recording: ``mav0/cam0/{data.csv, data, sensor.yaml}``, with ``cam1`` and the true states where present.

    Times are those of ``data.csv``. True poses are those of the body, interpolated and moved to the camera by its
    ``T_BS``. With ``cam1`` the two images are undistorted and rectified together, so camera and poses are those of the
    rectified left one; without, images are undistorted as any others.

    Args:
        root: The folder of one recording (that holds ``mav0``), or a folder above several.
        sequence: Its name, for example ``"MH_01_easy"`` or ``"MH_01"``. None takes the only one.
        stereo: Give the right images where there are any. ``False`` takes ``cam0`` alone.
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
        stereo: bool = True,
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        base = existing_root(root)
        names = _names(base)
        chosen = choose(_whole_name(sequence, names), names, base)
        folder = names[chosen]
        times, images = _listed(folder / "cam0")
        pinhole = _camera(folder / "cam0", images[0])
        bTc = _extrinsics(folder / "cam0")
        files = Files(images, times)
        pair: Rectification | None = None
        if stereo and (folder / "cam1").is_dir():
            pair, files.rights = _pair(folder, pinhole, bTc, times)
            pinhole, bTc = pair.camera, bTc @ pair.lTn
        files.poses = _true_poses(folder / TRUTH / "data.csv", times, bTc)
        super().__init__(safe_name(chosen), pinhole, files, start, stop, step)
        self._pair = pair
        if pair is not None:
            self._undistorter, self.baseline = pair.left, pair.baseline

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the recordings in ``root``.

        Raises:
            DataError: If there are none.
        """
        return list(_names(existing_root(options["root"])))

    def frame(self, index: int) -> Frame:
        """Read a frame; both images of a pair are rectified.

        Raises:
            DataError: If a file cannot be read; the message names it.
            IndexError: If the index is out of range.
        """
        frame = super().frame(index)
        if self._pair is None or frame.right is None:
            return frame
        return replace(frame, right=self._pair.right.image(frame.right))


def _names(base: Path) -> dict[str, Path]:
    """Return the folders ``mav0`` by the names of the recordings, which lie in groups such as ``machine_hall``."""
    if (base / "cam0").is_dir():
        return {base.resolve().parent.name: base}
    if (base / "mav0").is_dir():
        return {base.resolve().name: base / "mav0"}
    found = sorted(path for pattern in ("*/mav0", "*/*/mav0") for path in base.glob(pattern) if path.is_dir())
    if not found:
        mend = or_unpack(base, "check the option data.root")
        raise DataError(f"{base} is no recording and holds none (a folder with 'mav0/cam0'); {mend}.")
    if len({path.parent.name for path in found}) == len(found):
        return {path.parent.name: path for path in found}
    return {path.parent.relative_to(base).as_posix(): path for path in found}


def _whole_name(sequence: str | None, names: dict[str, Path]) -> str | None:
    """Return the only name that a short one such as ``MH_01`` begins, or what was given."""
    meant = [name for name in names if sequence and f"{name.rpartition('/')[2]}_".startswith(f"{sequence}_")]
    return meant[0] if len(meant) == 1 and sequence not in names else sequence


def _listed(folder: Path) -> tuple[NDArray[np.float64], list[Path]]:
    """Return the times in seconds and the image files of a camera."""
    times, paths = read_list(folder / "data.csv", f"{folder.name}'s")
    return times * NANOSECONDS, [folder / "data" / path.name for path in paths]


def _camera(folder: Path, image: Path) -> PinholeCamera:
    height, width = read_image(image).shape[:2]
    source = folder / "sensor.yaml"
    return camera_from_values(read_camera_file(source), str(source), width, height)


def _extrinsics(folder: Path) -> NDArray[np.float64]:
    """Return ``bTc``, (4, 4): where a camera stands as seen from the body.

    Raises:
        DataError: If its file has no ``T_BS``, or one that is no rigid transform.
    """
    path = folder / "sensor.yaml"
    try:
        values = yaml.safe_load(read_text(path, "the camera's calibration"))
        matrix = np.array(values["T_BS"]["data"], np.float64).reshape(4, 4)
    except DataError:
        raise
    except (yaml.YAMLError, KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise DataError(f"{path} has no T_BS with 16 numbers (sensor to body); copy the file anew.") from error
    return as_poses(matrix[:3].reshape(1, 12), path)[0]


def _pair(
    folder: Path, left: PinholeCamera, bTl: NDArray[np.float64], times: NDArray[np.float64]
) -> tuple[Rectification, list[Path | None]]:
    """Return how the pair is rectified, and the right image of each left one."""
    right_times, rights = _listed(folder / "cam1")
    right = _camera(folder / "cam1", rights[0])
    rTl = np.asarray(np.linalg.solve(_extrinsics(folder / "cam1"), bTl), np.float64)
    after = np.clip(np.searchsorted(right_times, times), 0, len(rights) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(right_times[before] - times) < np.abs(right_times[after] - times), before, after)
    together = np.abs(right_times[nearest] - times) <= AT_ONCE
    if not together.any():
        raise DataError(
            f"No image of {folder / 'cam1'} was taken within {AT_ONCE:g} s of one of cam0; set data.stereo=false."
        )
    return Rectification(left, right, rTl, folder), [
        rights[i] if found else None for i, found in zip(nearest, together, strict=True)
    ]


def _true_poses(path: Path, times: NDArray[np.float64], bTc: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the camera's true poses at the times of the images, None without a file."""
    if not path.is_file():
        return None
    states = read_table(path, 17, "time, position, quaternion, velocity and biases", finite=True)
    rows = states[:, TRUE_STATE]
    rows[:, 0] *= NANOSECONDS
    poses = poses_at(rows, times, path)
    return None if poses is None else poses @ bTc
