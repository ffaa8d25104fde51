"""Small recordings of rendered frames in the layouts of the data sets that the paper uses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import prgbd

FRAMES = 6
EARTH_RADIUS = 6378137.0


@dataclass(frozen=True)
class Rendered:
    """Encoded frames of a rendered world, their true depth and poses, and the camera."""

    images: list[bytes]
    depths: list[np.ndarray]
    poses: np.ndarray
    camera: prgbd.PinholeCamera


def render(world: str, width: int, height: int, fov: float) -> Rendered:
    """Render the first frames of a synthetic world."""
    sequence = prgbd.make_data("synthetic", sequence=world, frames=FRAMES, width=width, height=height, fov=fov)
    images = [png(sequence.frame(i).image[..., ::-1]) for i in range(FRAMES)]
    return Rendered(images, [sequence.depth(i) for i in range(FRAMES)], sequence.poses, sequence.camera)


def png(pixels: np.ndarray) -> bytes:
    found, data = cv2.imencode(".png", pixels)
    assert found
    return data.tobytes()


def _put(path: Path, content: bytes | str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def write_kitti_odometry(root: Path, rendered: Rendered, names: Iterable[str]) -> Path:
    """Write ``sequences/XX`` with the gray camera's folder, and ``poses/XX.txt``."""
    P = np.hstack([rendered.camera.K, np.zeros((3, 1))])
    rows = "".join(" ".join(map(repr, pose[:3].ravel().tolist())) + "\n" for pose in rendered.poses)
    for name in names:
        folder = root / "sequences" / name
        for i, image in enumerate(rendered.images):
            _put(folder / "image_0" / f"{i:06d}.png", image)
        _put(folder / "calib.txt", f"P0: {' '.join(map(repr, P.ravel().tolist()))}\n")
        _put(folder / "times.txt", "".join(f"{0.1 * i:e}\n" for i in range(FRAMES)))
        _put(root / "poses" / f"{name}.txt", rows)
    return root


def write_kitti_raw(root: Path, rendered: Rendered, drives: Iterable[str], day: str = "2011_09_26") -> Path:
    """Write drives with colour images, scans that see every fourth pixel, and GPS, and the calibration of their day."""
    P = np.hstack([rendered.camera.K, np.zeros((3, 1))])
    lines = ["calib_time: x", "R_rect_00: 1 0 0 0 1 0 0 0 1", f"P_rect_02: {' '.join(map(repr, P.ravel().tolist()))}"]
    _put(root / day / "calib_cam_to_cam.txt", "\n".join(lines) + "\n")
    _put(root / day / "calib_velo_to_cam.txt", "calib_time: x\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n")
    _put(root / day / "calib_imu_to_velo.txt", "calib_time: x\nR: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
    began = datetime(2011, 9, 26, 13, 2, 25, tzinfo=UTC)
    for name in drives:
        drive = root / day / f"{day}_drive_{name}_sync"
        stamps = [began + timedelta(seconds=0.1 * i) for i in range(FRAMES)]
        _put(drive / "image_02" / "timestamps.txt", "".join(f"{t:%Y-%m-%d %H:%M:%S.%f}\n" for t in stamps))
        for i, image in enumerate(rendered.images):
            _put(drive / "image_02" / "data" / f"{i:010d}.png", image)
            _put(drive / "velodyne_points" / "data" / f"{i:010d}.bin", _scan(rendered, i))
            _put(drive / "oxts" / "data" / f"{i:010d}.txt", _oxts(rendered.poses[i]))
    return root


def _scan(rendered: Rendered, index: int) -> bytes:
    """A scan of the velodyne, whose x is the camera's z, y its -x, and z its -y."""
    depth = rendered.depths[index]
    v, u = (grid.ravel() for grid in np.mgrid[0 : depth.shape[0] : 4, 0 : depth.shape[1] : 4])
    seen = depth[v, u] > 0
    v, u = v[seen], u[seen]
    # The published evaluation counts pixels from 1, so its (u, v) is the camera's (u + 1, v + 1).
    xyz = rendered.camera.backproject(np.stack([u + 1, v + 1], axis=1).astype(float), depth[v, u])
    return np.stack([xyz[:, 2], -xyz[:, 0], -xyz[:, 1], np.ones(len(xyz))], axis=1).astype(np.float32).tobytes()


def _oxts(wTc: np.ndarray, latitude: float = 49.0, longitude: float = 8.4) -> str:
    """A line of GPS and inertia for a camera whose world has y down: its x is east and its z north."""
    east, down, north = wTc[:3, 3]
    heading = np.arctan2(wTc[2, 2], wTc[0, 2])
    around = EARTH_RADIUS * np.cos(np.radians(latitude))
    place = latitude + np.degrees(north / EARTH_RADIUS), longitude + np.degrees(east / around), 115.0 - down
    values = [*place, 0, 0, heading]
    return " ".join(map(repr, map(float, [*values, *[0] * 24])))


def write_split(path: Path, drives: Iterable[str], frames: Iterable[int], day: str = "2011_09_26") -> Path:
    """Write a split file as the published ones are."""
    chosen = list(frames)
    _put(path, "".join(f"{day}/{day}_drive_{name}_sync {i:010d} l\n" for name in drives for i in chosen))
    return path


def write_tum(root: Path, rendered: Rendered, names: Iterable[str], start: float = 1305031229.5) -> Path:
    """Write recordings with colour, depth and motion capture."""
    stamps = [f"{start + i / 30:.6f}" for i in range(FRAMES)]
    levels = [png((5000 * depth).round().clip(0, 65535).astype(np.uint16)) for depth in rendered.depths]
    truth = [
        " ".join([stamp, *(f"{x:.6f}" for x in (*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()))])
        for stamp, pose in zip(stamps, rendered.poses, strict=True)
    ]
    for name in names:
        for stamp, image, level in zip(stamps, rendered.images, levels, strict=True):
            _put(root / name / "rgb" / f"{stamp}.png", image)
            _put(root / name / "depth" / f"{stamp}.png", level)
        for kind in ("rgb", "depth"):
            _put(root / name / f"{kind}.txt", "# list\n" + "".join(f"{s} {kind}/{s}.png\n" for s in stamps))
        _put(root / name / "groundtruth.txt", "# pose\n" + "\n".join(truth) + "\n")
    return root
