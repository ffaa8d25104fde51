"""Small recordings written by tests."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

import prgbd
from prgbd.core.types import PinholeCamera

WIDTH, HEIGHT = 64, 48


def picture(number: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """An RGB image that tells its number: red carries it, blue is 200 everywhere, green is a ramp."""
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0] = 10 * number
    image[..., 1] = np.linspace(0, 255, width).astype(np.uint8)
    image[..., 2] = 200
    return image


def write_picture(path: Path, number: int, width: int = WIDTH, height: int = HEIGHT) -> Path:
    return write_image(path, picture(number, width, height))


def write_image(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])
    return path


def write_depth(path: Path, levels: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), levels.astype(np.uint16))
    return path


def views_of_room(camera: PinholeCamera) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Image, depth and pose of two views, 0.3 m apart, of the synthetic room as that camera sees it."""
    room = prgbd.make_data("synthetic", scene="indoor", frames=8, width=camera.width, height=camera.height, noise=0)
    room.camera = camera
    return [(room.frame(i).image, room.depth(i), room.poses[i]) for i in (0, 7)]


def cut(path: Path, part: float = 0.6) -> None:
    """Cut a file off, as an interrupted copy does."""
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])


def turn(degrees: float) -> np.ndarray:
    """Rotation about y."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
