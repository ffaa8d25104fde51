"""What must hold of a map file before its numbers are used: compiled code follows them wherever they lead."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import PinholeCamera
from prgbd.io.arrays import TEXT, Entry, read_arrays

KIND = "prgbd orb_gtsam map"
FORMAT = 1
WHAT = "map of orb_gtsam"
# Self-calibration changes a focal length by a few percent.
_FOCAL_CHANGE = 2.0

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class MapHeader:
    """What a map file says of itself.

    Attributes:
        camera: The camera, as self-calibration left it.
        given_camera: The camera as the user gave it.
        mode: ``mono``, ``rgbd`` or ``stereo``.
        baseline: Metres; 0 for mono.
        scales: Scale of every pyramid level, finest first.
    """

    camera: PinholeCamera
    given_camera: PinholeCamera
    mode: str
    baseline: float
    scales: tuple[float, ...]


def read_header(path: Path) -> MapHeader:
    """Read what a map file says of itself.

    Raises:
        DataError: If it is no map of this version, or the header does not make sense.
    """
    text = str(read_arrays(path, {"header": TEXT}, WHAT)["header"])
    try:
        header = json.loads(text)
        if header.get("kind") != KIND:
            raise ValueError("its header says something else")
        found = header["format"]
    except (ValueError, KeyError, AttributeError, RecursionError) as error:
        raise DataError(f"{path} is not a whole {WHAT} ({error}); make one with slam.save_map.") from error
    if found != FORMAT:
        raise DataError(
            f"The map {path} has format {found!s:.40}, and this version of prgbd reads format {FORMAT}; "
            "save it again with this version."
        )
    try:
        return _header_of(header)
    except (ConfigError, ValueError, TypeError, KeyError, OverflowError) as error:
        raise DataError(f"The header of the map {path} does not make sense ({error}); save it again.") from error


def _header_of(header: dict[str, Any]) -> MapHeader:
    camera, given = (_camera_of(header[name]) for name in ("camera", "given_camera"))
    baseline, scales = _numbers([header["baseline"]])[0], _numbers(header["scales"])
    if header["mode"] not in ("mono", "rgbd", "stereo"):
        raise ValueError("no known mode")
    if baseline < 0 or (header["mode"] != "mono" and baseline == 0):
        raise ValueError("no positive baseline")
    if not 1 <= len(scales) <= 16 or min(scales) < 1:
        raise ValueError("no scales of pyramid levels")
    same = (camera.width, camera.height) == (given.width, given.height)
    if not same or not all(
        1 / _FOCAL_CHANGE < refined / first < _FOCAL_CHANGE
        for refined, first in ((camera.fx, given.fx), (camera.fy, given.fy))
    ):
        raise ValueError("the refined camera is another one than the given camera")
    return MapHeader(camera, given, header["mode"], baseline, scales)


def _camera_of(node: dict[str, Any]) -> PinholeCamera:
    width, height, fx, fy, cx, cy = _numbers([node[name] for name in ("width", "height", "fx", "fy", "cx", "cy")])
    return PinholeCamera(int(width), int(height), fx, fy, cx, cy, _numbers(node["distortion"]))


def _numbers(values: list[Any]) -> tuple[float, ...]:
    if not isinstance(values, list) or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
        raise ValueError("something other than a number where a number belongs")
    numbers = tuple(float(value) for value in values)
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError("a number that is not finite")
    return numbers


def read_columns(path: Path, header: MapHeader, cells: int) -> Arrays:
    """Read all columns of a map file.

    Args:
        path: The file.
        header: What it says of itself.
        cells: Grid cells of an image.

    Raises:
        DataError: If a column is absent, of another type or shape, has numbers out of range, or they contradict each
            other.
    """
    arrays = read_arrays(path, _schema(header, cells), WHAT)
    if wrong := _contradiction(arrays):
        raise DataError(f"The map {path} does not hold together ({wrong}); save it again.")
    return arrays


def _schema(header: MapHeader, cells: int) -> dict[str, Entry]:
    """Return what every column must be: K keyframes with N keypoints in all, P points."""
    width, height = header.camera.width, header.camera.height
    per_keyframe = {
        "cTw": Entry("f", ("K", 4, 4)),
        "centre": Entry("f", ("K", 3)),
        "frame_index": Entry("i", ("K",)),
        "timestamp": Entry("f", ("K",)),
        "map_id": Entry("i", ("K",), 0, 2**30),
        "bad": Entry("b", ("K",)),
        "parent": Entry("i", ("K",), -1, below="K"),
        "cTparent": Entry("f", ("K", 4, 4)),
        "size": Entry("i", ("K",), 0),
        "cell_start": Entry("i", ("K", cells + 1), 0),
        "median_depth": Entry("f", ("K",), 0, required=False),
        "scale": Entry("f", ("K",), 1e-9, 1e9, required=False),
    }
    per_keypoint = {
        "uv": Entry("f", ("N", 2), -1, max(width, height) + 1),
        "octave": Entry("i", ("N",), 0, len(header.scales) - 1),
        "angle": Entry("f", ("N",), -360, 360),
        "descriptor": Entry("u", ("N", 4), 0, 2**64),
        "depth": Entry("f", ("N",), 0),
        "u_right": Entry("f", ("N",)),
        "rgb": Entry("u", ("N", 3), 0, 255),
        "point": Entry("i", ("N",), -1, below="P"),
    }
    per_point = {
        "xyz": Entry("f", ("P", 3)),
        "normal": Entry("f", ("P", 3), -2, 2),
        "distance_range": Entry("f", ("P", 2), 0),
        "descriptor": Entry("u", ("P", 4), 0, 2**64),
        "rgb": Entry("u", ("P", 3), 0, 255),
        "reference": Entry("i", ("P",), -1, below="K"),
        "created": Entry("i", ("P",), -1, below="K"),
        "visible": Entry("i", ("P",), 0),
        "found": Entry("i", ("P",), 0),
        "bad": Entry("b", ("P",)),
        "replaced_by": Entry("i", ("P",), -1, below="P"),
    }
    tables = {"keyframes": per_keyframe, "keypoints": per_keypoint, "points": per_point}
    return {f"{table}.{name}": entry for table, columns in tables.items() for name, entry in columns.items()}


def _contradiction(arrays: Arrays) -> str:
    """Say what contradicts what, "" if nothing does."""
    cTw, size, start = arrays["keyframes.cTw"], arrays["keyframes.size"], arrays["keyframes.cell_start"]
    point, points = arrays["keypoints.point"], len(arrays["points.xyz"])
    R, t = cTw[:, :3, :3], cTw[:, :3, 3]
    off_centre = np.abs(arrays["keyframes.centre"] + np.einsum("kji,kj->ki", R, t))
    seen = point >= 0
    far = 1e-6 * (1 + np.abs(t).max(initial=0))
    checks = {
        "'keyframes.size' does not add up to the keypoints": size.sum() != len(point),
        "'keyframes.cTw' has poses that are no rigid transforms": not _all_rigid(cTw),
        "'keyframes.centre' is not where 'keyframes.cTw' says": (off_centre > far).any(),
        "'keyframes.cell_start' does not ascend from 0 to 'keyframes.size'": (
            (np.diff(start, axis=1) < 0).any() or (start[:, 0] != 0).any() or (start[:, -1] != size).any()
        ),
        "'keyframes.bad' or 'points.bad' marks something": arrays["keyframes.bad"].any() or arrays["points.bad"].any(),
        "'keypoints.point' leaves out a point": len(np.unique(point[seen])) != points,
        "'points.distance_range' is upside down": (np.diff(arrays["points.distance_range"], axis=1) < 0).any(),
    }
    return next((words for words, wrong in checks.items() if wrong), "")


def _all_rigid(poses: NDArray[np.float64]) -> bool:
    rotation = poses[:, :3, :3]
    straight = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(initial=0) < 1e-4
    whole = np.abs(poses[:, 3] - [0, 0, 0, 1]).max(initial=0) < 1e-8
    return bool(straight and whole and (np.linalg.det(rotation) > 0).all())
