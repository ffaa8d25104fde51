"""KITTI raw's calibration, and what follows from it: true depth from the velodyne, true poses from GPS and inertia.

Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013; the devkit's readme for the formats.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.io.text_tables import text_lines

EARTH_RADIUS = 6378137.0  # metres, at the equator
OXTS_VALUES = 30  # a line of OXTS holds latitude, longitude, altitude, roll, pitch, yaw, ... in this number


@dataclass(frozen=True)
class DayCalibration:
    """The calibration of one day of recording.

    Attributes:
        P: (3, 4) rectified projection matrix of the camera.
        P_right: Likewise of the camera to its right, or None.
        rTv: (4, 4) velodyne to rectified camera 0, or None without ``calib_velo_to_cam.txt``.
        vTi: (4, 4) inertial unit to velodyne, or None without ``calib_imu_to_velo.txt``.
    """

    P: NDArray[np.float64]
    P_right: NDArray[np.float64] | None
    rTv: NDArray[np.float64] | None
    vTi: NDArray[np.float64] | None

    @property
    def cTr(self) -> NDArray[np.float64]:
        """Rectified camera 0 to the camera, (4, 4): a translation."""
        out = np.eye(4)
        out[:3, 3] = np.linalg.solve(self.P[:, :3], self.P[:, 3])
        return out

    @property
    def baseline(self) -> float | None:
        """Metres from the camera to the one at its right."""
        return None if self.P_right is None else float((self.P[0, 3] - self.P_right[0, 3]) / self.P[0, 0])


def read_day(folder: Path, camera: int, right: int) -> DayCalibration:
    """Read the calibration files of a day.

    Args:
        folder: The folder of the day, ``2011_09_26``.
        camera: Number of the camera.
        right: Number of the camera at its right.

    Raises:
        DataError: If ``calib_cam_to_cam.txt`` is absent or a needed entry is absent or malformed.
    """
    path = folder / "calib_cam_to_cam.txt"
    cameras = _entries(path)
    P = _matrix(cameras, f"P_rect_{camera:02d}", (3, 4), path)
    if min(P[0, 0], P[1, 1]) <= 0:
        raise DataError(f"P_rect_{camera:02d} in {path} has a focal length that is not positive; copy the file anew.")
    key = f"P_rect_{right:02d}"
    rectify = np.eye(4)
    rTv = _rigid(folder / "calib_velo_to_cam.txt")
    if rTv is not None:
        rectify[:3, :3] = _matrix(cameras, "R_rect_00", (3, 3), path)
        rTv = rectify @ rTv
    P_right = _matrix(cameras, key, (3, 4), path) if key in cameras else None
    return DayCalibration(P, P_right, rTv, _rigid(folder / "calib_imu_to_velo.txt"))


def velodyne_depth(
    scan: NDArray[np.float32], day: DayCalibration, width: int, height: int, forward: bool
) -> NDArray[np.float32]:
    """Return sparse depth from a scan, as the Eigen split is evaluated with it (Monodepth2's export).

    Args:
        scan: (N, 4) x forward, y left, z up in metres, and reflectance.
        day: The calibration.
        width: Of the image, pixels.
        height: Likewise.
        forward: Whether depth is the distance in front of the velodyne, as in the published evaluation, or the depth
            z of the camera, 0.27 m less.

    Returns:
        (height, width) float32 metres, 0 where no point falls; the nearest point where several do.
    """
    assert day.rTv is not None
    points = scan[scan[:, 0] >= 0].astype(np.float64)
    points[:, 3] = 1.0
    projected = points @ (day.P @ day.rTv).T
    in_front = projected[:, 2] > 0
    points, projected = points[in_front], projected[in_front]
    # The published evaluation counts pixels from one, as the devkit's Matlab does, and so takes one off.
    column, row = (np.round(projected[:, :2] / projected[:, 2:]) - 1).astype(np.int64).T
    values = points[:, 0] if forward else projected[:, 2]
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    depth = np.full(height * width, np.inf)
    np.minimum.at(depth, row[inside] * width + column[inside], values[inside])
    depth[~np.isfinite(depth) | (depth < 0)] = 0.0
    return depth.reshape(height, width).astype(np.float32)


def read_scan(path: Path) -> NDArray[np.float32]:
    """Read a velodyne scan, (N, 4) float32.

    Raises:
        DataError: If the file is unreadable or cut off.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"The velodyne scan {path} cannot be read ({error.strerror}); copy it anew.") from error
    whole = len(data) > 0 and len(data) % 16 == 0
    values = np.frombuffer(data, np.float32) if whole else np.zeros(0, np.float32)
    if not whole or not np.isfinite(values).all():
        raise DataError(f"{path} is truncated or no velodyne scan; copy it anew.")
    return values.reshape(-1, 4)


def camera_poses(files: list[Path | None], day: DayCalibration) -> NDArray[np.float64] | None:
    """Return ``wTc``, (N, 4, 4), from OXTS files, with the first known camera as the world; NaN without a file.

    Latitude and longitude become metres by a Mercator projection that keeps lengths at the first latitude (devkit,
    ``convertOxtsToPose``).

    Raises:
        DataError: If a file is malformed.
    """
    known = [i for i, path in enumerate(files) if path is not None]
    if not known or day.rTv is None or day.vTi is None:
        return None
    rows = np.array([_oxts(files[i]) for i in known])  # type: ignore[arg-type]
    latitude, longitude, altitude, roll, pitch, yaw = rows.T
    scale = np.cos(np.radians(latitude[0])) * EARTH_RADIUS
    east = scale * np.radians(longitude)
    north = scale * np.log(np.tan(np.pi * (90.0 + latitude) / 360.0))
    mTi = np.tile(np.eye(4), (len(rows), 1, 1))
    mTi[:, :3, :3] = _turn(yaw, 2) @ _turn(pitch, 1) @ _turn(roll, 0)
    mTi[:, :3, 3] = np.stack([east, north, altitude], 1)
    mTc = mTi @ np.linalg.inv(day.cTr @ day.rTv @ day.vTi)
    poses = np.full((len(files), 4, 4), np.nan)
    poses[known] = np.linalg.inv(mTc[0]) @ mTc
    return poses


def _turn(angle: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Rotations (N, 3, 3) about x, y or z."""
    out = np.zeros((len(angle), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[:, axis, axis] = 1.0
    out[:, a, a] = out[:, b, b] = np.cos(angle)
    out[:, a, b], out[:, b, a] = -np.sin(angle), np.sin(angle)
    return out


def _oxts(path: Path) -> list[float]:
    lines = text_lines(path, "GPS and inertial data")
    try:
        values = [float(word) for word in lines[0][1]] if lines else []
    except ValueError:
        values = []
    if len(values) != OXTS_VALUES or not np.isfinite(values[:6]).all():
        raise DataError(f"{path} is no line of {OXTS_VALUES} numbers (GPS and inertial data); copy it anew.")
    return values[:6]


def _entries(path: Path) -> dict[str, list[str]]:
    return {words[0].rstrip(":"): words[1:] for _, words in text_lines(path, "calibration")}


def _matrix(entries: dict[str, list[str]], key: str, shape: tuple[int, int], path: Path) -> NDArray[np.float64]:
    if key not in entries:
        raise DataError(f"{path} has no line {key}; copy the calibration of the day anew.")
    try:
        values = np.array([float(word) for word in entries[key]])
    except ValueError:
        values = np.zeros(0)
    if values.size != shape[0] * shape[1] or not np.isfinite(values).all():
        raise DataError(f"The line {key} of {path} is not {shape[0] * shape[1]} finite numbers; copy the file anew.")
    return values.reshape(shape)


def _rigid(path: Path) -> NDArray[np.float64] | None:
    """The transform R, T of a calibration file, or None without the file."""
    if not path.is_file():
        return None
    entries = _entries(path)
    out = np.eye(4)
    out[:3, :3] = _matrix(entries, "R", (3, 3), path)
    out[:3, 3] = _matrix(entries, "T", (3, 1), path)[:, 0]
    return out
