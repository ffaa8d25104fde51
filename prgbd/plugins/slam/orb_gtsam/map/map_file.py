"""A map in one file, so that another recording of the same place can be tracked in it and extend it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError
from prgbd.core.types import PinholeCamera
from prgbd.io.files import atomic_path, to_plain
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.map.columns import Columns
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_correction import follow_baseline
from prgbd.plugins.slam.orb_gtsam.map.map_schema import FORMAT, KIND, MapHeader, read_columns, read_header
from prgbd.plugins.slam.orb_gtsam.settings import Settings

# Rebuilt from the other columns when a map is read.
_LINKS = ("following", "head")
# Of the run alone: the depth of a finished map is as it was measured.
_PASSING = ("log_depth_scale", "aligned", "precision")
# Columns that hold numbers of keyframes or points.
_NUMBERS = {
    "parent": "keyframe",
    "reference": "keyframe",
    "created": "keyframe",
    "point": "point",
    "replaced_by": "point",
}
# Columns whose place in a row is not a keypoint, whatever its size.
_PER_KEYFRAME = ("cell_start",)
_PIXELS = 1e-3


def save_map(slam_map: Map, camera: CameraModel, given: PinholeCamera, settings: Settings, path: Path | str) -> None:
    """Write the whole map to one compressed ``.npz`` without pickles, whole or not at all.

    Keyframes and points that are alive are numbered anew; culled ones are left out.

    Args:
        slam_map: The map; the caller holds its lock.
        camera: The camera, as self-calibration left it.
        given: The camera as the user gave it, by which recordings of the same camera are recognised.
        settings: Kept for people to read; only the pyramid has to be the same when the map is loaded.
        path: The file.
    """
    kf, pts = slam_map.keyframes, slam_map.points
    header = {
        "kind": KIND,
        "format": FORMAT,
        "camera": camera.pinhole.to_dict(),
        "given_camera": given.to_dict(),
        "mode": camera.mode,
        "baseline": camera.baseline,
        "scales": camera.scales,
        "settings": asdict(settings),
    }
    keyframes = np.flatnonzero(~kf.bad[: kf.count])
    points = np.flatnonzero(~pts.bad[: pts.count] & (pts.head[: pts.count] >= 0))
    successors = np.array([*map(slam_map.successor, range(kf.count)), -1])
    new_row = {"keyframe": _renumbered(keyframes, kf.count)[successors], "point": _renumbered(points, pts.count)}
    used = np.arange(slam_map.capacity) < kf.size[keyframes, None]
    columns: dict[str, Any] = {"header": np.array(json.dumps(to_plain(header)))}
    for kind, rows, table in (("keyframes", keyframes, kf), ("points", points, pts)):
        for name in _stored(table):
            column = getattr(table, name)[rows]
            if name in _NUMBERS:
                column = new_row[_NUMBERS[name]][column]
            per_keypoint = table is kf and _is_keypoint_column(name, column, slam_map.capacity)
            columns[f"keypoints.{name}" if per_keypoint else f"{kind}.{name}"] = (
                column[used] if per_keypoint else column
            )
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **columns)


def load_map(slam_map: Map, camera: CameraModel, path: Path | str) -> None:
    """Fill an empty map from a file that ``save_map`` wrote.

    Keyframes of earlier recordings get negative frame numbers, ``-1 - index``: they are no frames of the present one.
    The map with most keyframes gets the highest number and becomes the current one.

    Args:
        slam_map: The map, without keyframes.
        camera: The camera of the present recording; gets the focal length that the map has refined.
        path: The file.

    Raises:
        DataError: If the file is missing, damaged, or no map of this version.
        ConfigError: If the map was made with another camera, mode or pyramid, or has keyframes with more keypoints.
    """
    path = Path(path)
    header = read_header(path)
    _require_fit(path, header, camera)
    arrays = read_columns(path, header, slam_map.keyframes.cell_start.shape[1] - 1)
    _require_room(path, arrays["keyframes.size"], slam_map)
    _fill(slam_map, arrays)
    camera.pinhole = replace(camera.pinhole, fx=header.camera.fx, fy=header.camera.fy)
    kf = slam_map.keyframes
    if header.mode != "mono" and header.baseline != camera.baseline:
        follow_baseline(slam_map, camera)
    kf.frame_index[: kf.count] = np.where(
        kf.frame_index[: kf.count] >= 0, -1 - kf.frame_index[: kf.count], kf.frame_index[: kf.count]
    )
    _order_maps(slam_map)


def loaded_keyframes(slam_map: Map) -> int:
    """Return how many keyframes of earlier recordings are in the map."""
    kf = slam_map.keyframes
    return int(np.count_nonzero(~kf.bad[: kf.count] & (kf.frame_index[: kf.count] < 0)))


def _fill(slam_map: Map, arrays: dict[str, NDArray[Any]]) -> None:
    kf, pts = slam_map.keyframes, slam_map.points
    size = arrays["keyframes.size"]
    kf.grow(len(size))
    pts.grow(len(arrays["points.bad"]))
    used = np.arange(slam_map.capacity) < size[:, None]
    point = np.full(used.shape, -1, np.int64)
    point[used] = arrays["keypoints.point"]
    for kind, columns in (("keyframes", kf), ("keypoints", kf), ("points", pts)):
        for name in _stored(columns):
            stored, column = arrays.get(f"{kind}.{name}"), getattr(columns, name)[: columns.count]
            if stored is None or name == "point":
                continue  # a column that this version added keeps its fill value
            if kind == "keypoints":
                column[used] = stored
            else:
                column[:] = stored
    for k in range(kf.count):
        rows = np.flatnonzero(point[k] >= 0)
        slam_map.observe(k, rows, point[k, rows])


def _order_maps(slam_map: Map) -> None:
    """Number the maps from the smallest to the largest, which becomes the current one."""
    kf = slam_map.keyframes
    known, row = np.unique(kf.map_id[: kf.count], return_inverse=True)
    sizes = np.bincount(row[~kf.bad[: kf.count]], minlength=len(known))
    rank = np.empty(len(known), np.int32)
    rank[np.argsort(sizes, kind="stable")] = np.arange(len(known))
    kf.map_id[: kf.count] = rank[row]
    slam_map.current_map = len(known) - 1


def _stored(columns: Columns) -> list[str]:
    """Names of all columns but the links and what only a run needs."""
    return [name for name in columns.names if name not in (*_LINKS, *_PASSING)]


def _renumbered(rows: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the new number of every old row, -1 for those left out; also for -1 itself, which is the last entry."""
    numbers = np.full(count + 1, -1, np.int64)
    numbers[rows] = np.arange(len(rows))
    return numbers


def _is_keypoint_column(name: str, column: NDArray[Any], capacity: int) -> bool:
    return name not in _PER_KEYFRAME and column.ndim >= 2 and column.shape[1] == capacity


def _require_fit(path: Path, header: MapHeader, camera: CameraModel) -> None:
    then, now = header.given_camera, camera.pinhole
    names = ("width", "height", "fx", "fy", "cx", "cy")
    if any(abs(getattr(then, name) - getattr(now, name)) > _PIXELS for name in names):
        shown = " and ".join(
            f"{c.width}x{c.height} fx={c.fx:g} fy={c.fy:g} cx={c.cx:g} cy={c.cy:g}" for c in (then, now)
        )
        raise ConfigError(f"The map {path} and the recording have different cameras, {shown}; use the same camera.")
    mode = camera.mode
    if header.mode != mode:
        raise ConfigError(f"The map {path} was made in mode {header.mode}, not {mode}; set slam.mode to the same.")
    if not np.array_equal(header.scales, camera.scales):
        scales = header.scales
        factor = f" and slam.features.scale_factor={scales[1]:g}" if len(scales) > 1 else ""
        raise ConfigError(f"The map {path} was made with slam.features.levels={len(scales)}{factor}; set the same.")


def _require_room(path: Path, size: NDArray[np.int64], slam_map: Map) -> None:
    most = int(size.max(initial=0))
    if most > slam_map.capacity:
        raise ConfigError(
            f"The map {path} has keyframes with {most} keypoints, more than slam.features.count={slam_map.capacity}; "
            f"set slam.features.count={most}."
        )
