"""The folder of what SLAM found out: npz with everything, and trajectories and maps that other programs read.

The heavy libraries are imported where they are used, so this module is cheap to import.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError, PrgbdError
from prgbd.core.types import Frame, Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory
from prgbd.core.validation import check_poses
from prgbd.io.arrays import TEXT, Entry, read_arrays
from prgbd.io.files import atomic_path, to_plain, write_json
from prgbd.io.trajectory_files import write_kitti, write_tum

FORMAT = 1
FORMATS = ("tum", "kitti", "ply", "colmap", "colmap_images")
DEFAULT_FORMATS = ("tum", "kitti", "ply")
CAMERA_COLOUR = (255, 128, 0)


def _trajectory(count: str, *, required: bool = True) -> dict[str, Entry]:
    return {
        "frame_index": Entry("iu", (count,), required=required),
        "timestamp": Entry("fiu", (count,), required=required),
        "wTc": Entry("f", (count, 4, 4), required=required),
    }


RESULT = {
    "header": TEXT,
    "states": Entry("U", ("frames",)),
    "inliers": Entry("iu", ("frames",), 0),
    **{f"trajectory.{name}": entry for name, entry in _trajectory("poses").items()},
    **{f"online.{name}": entry for name, entry in _trajectory("online poses", required=False).items()},
    **{f"keyframes.{name}": entry for name, entry in _trajectory("keyframes").items()},
    "keyframes.map_id": Entry("iu", ("keyframes",)),
    "points.xyz": Entry("f", ("points", 3)),
    "points.rgb": Entry("u", ("points", 3), 0, 255),
    "observations.keyframe": Entry("iu", ("observations",), 0, below="keyframes"),
    "observations.point": Entry("iu", ("observations",), 0, below="points"),
    "observations.uv": Entry("f", ("observations", 2)),
    "observations.depth": Entry("f", ("observations",)),
}
"""What ``save_arrays`` writes, by name."""


def save_arrays(result: SlamResult, path: Path | str) -> None:
    """Write everything in ``result`` to one compressed ``.npz`` without pickles, whole or not at all."""
    header = {
        "format": FORMAT,
        "camera": result.camera.to_dict(),
        "mode": result.mode,
        "frames": result.frames,
        "stats": result.stats,
    }
    columns: dict[str, Any] = {
        "header": np.array(json.dumps(to_plain(header))),
        "states": np.array([str(s) for s in result.states], dtype=np.str_),
        "inliers": np.asarray(result.inliers, np.int32),
        **_columns("trajectory", result.trajectory, ("frame_index", "timestamp", "wTc")),
        **_columns("keyframes", result.keyframes, ("frame_index", "timestamp", "wTc", "map_id")),
        **_columns("points", result.points, ("xyz", "rgb")),
        **_columns("observations", result.observations, ("keyframe", "point", "uv", "depth")),
    }
    if result.online is not None:
        columns |= _columns("online", result.online, ("frame_index", "timestamp", "wTc"))
    path = Path(path)
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **columns)


def _columns(prefix: str, holder: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {f"{prefix}.{name}": np.asarray(getattr(holder, name)) for name in names}


def load_result(path: Path | str) -> SlamResult:
    """Read what ``save_result`` wrote, or the folder ``loops/00/slam/SEQUENCE`` of a run.

    Args:
        path: The folder, or its ``result.npz``.

    Raises:
        DataError: If there is no whole result.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "result.npz"
    if not path.is_file():
        raise DataError(f"There is no SLAM result {path}; run SLAM first.")
    arrays = read_arrays(path, RESULT, "SLAM result")
    try:
        result = _result_from(arrays)
        for trajectory in filter(None, (result.trajectory, keyframe_trajectory(result.keyframes), result.online)):
            check_poses(trajectory.wTc, trajectory.frame_index, "It")
        return result
    except (PrgbdError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise DataError(f"{path} is not a whole SLAM result ({error}); delete it and run SLAM again.") from error


def _result_from(arrays: dict[str, NDArray[Any]]) -> SlamResult:
    header = json.loads(str(arrays["header"]))
    if header["format"] != FORMAT:
        raise ValueError(f"format {header['format']} instead of {FORMAT}")
    camera, mode, frames, stats = (header[name] for name in ("camera", "mode", "frames", "stats"))
    if frames != len(arrays["states"]) or not isinstance(mode, str) or not isinstance(stats, dict):
        raise ValueError("its header does not fit its columns")

    def part(prefix: str) -> dict[str, NDArray[Any]]:
        return {k.split(".", 1)[1]: v for k, v in arrays.items() if k.startswith(prefix + ".")}

    online = part("online")
    return SlamResult(
        camera=PinholeCamera(**{**camera, "distortion": tuple(camera["distortion"])}),
        mode=mode,
        frames=frames,
        trajectory=Trajectory(**part("trajectory")),
        keyframes=Keyframes(**part("keyframes")),
        points=MapPoints(**part("points")),
        observations=Observations(**part("observations")),
        states=[str(s) for s in arrays["states"]],
        inliers=arrays["inliers"],
        online=Trajectory(**online) if online else None,
        stats=stats,
    )


def keyframe_trajectory(keyframes: Keyframes) -> Trajectory:
    """Return the keyframes' poses as a trajectory."""
    return Trajectory(keyframes.frame_index, keyframes.timestamp, keyframes.wTc)


def write_ply(points: MapPoints, path: Path | str, centres: NDArray[np.float64] | None = None) -> int:
    """Write a binary little-endian PLY of coloured points.

    Args:
        points: The map; points that are not finite are left out.
        path: The file.
        centres: (N, 3) camera centres to add as orange points, or None.

    Returns:
        Number of vertices written.
    """
    vertex = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
    extra = np.zeros((0, 3)) if centres is None else np.asarray(centres, np.float64)
    vertices = np.zeros(len(points) + len(extra), vertex)
    vertices["xyz"] = np.concatenate([points.xyz.reshape(-1, 3), extra])
    vertices["rgb"][: len(points)] = points.rgb.reshape(-1, 3)
    vertices["rgb"][len(points) :] = CAMERA_COLOUR
    vertices = vertices[np.isfinite(vertices["xyz"]).all(axis=1)]
    properties = [f"property float {a}" for a in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *properties,
        "end_header",
        "",
    ]
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + vertices.tobytes())
    return len(vertices)


def check_formats(formats: Iterable[str]) -> tuple[str, ...]:
    """Return the formats of ``save_result`` without repeats.

    Raises:
        ConfigError: If one of them is unknown.
    """
    formats = tuple(dict.fromkeys([formats] if isinstance(formats, str) else formats))
    for name in formats:
        if name not in FORMATS:
            near = difflib.get_close_matches(str(name), FORMATS, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"choose from {', '.join(FORMATS)}."
            raise ConfigError(f"There is no export format '{name}'; {hint}")
    return formats


def save_result(
    result: SlamResult,
    folder: Path | str,
    formats: Iterable[str] = DEFAULT_FORMATS,
    *,
    frame: Callable[[int], Frame] | None = None,
) -> None:
    """Write one sequence's result into ``folder``: ``result.npz``, ``slam.json`` and what else is asked for.

    ``result.npz`` comes last, so a folder that has it is complete.

    Args:
        result: What SLAM found.
        folder: The folder; made if needed.
        formats: Any of ``FORMATS``: ``tum`` (``trajectory.tum, keyframes.tum, online.tum``), ``kitti``
            (``trajectory.kitti, keyframes.kitti``), ``ply`` (``map.ply``), ``colmap`` (``colmap/sparse/0``) and
            ``colmap_images`` (the same with the keyframes' images in ``colmap/images``).
        frame: Returns the frame of a number; needed for ``colmap_images``.

    Raises:
        ConfigError: If a format is unknown, ``colmap_images`` is asked for without ``frame``, or the folder cannot be
            made.
    """
    formats = check_formats(formats)
    if "colmap_images" in formats and frame is None:
        raise ConfigError("The format colmap_images needs the frames; give frame=sequence.frame, or use colmap.")
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"The folder {folder} cannot be made ({error.strerror}); choose another.") from error
    keyframes = keyframe_trajectory(result.keyframes)
    if "tum" in formats:
        write_tum(result.trajectory, folder / "trajectory.tum")
        write_tum(keyframes, folder / "keyframes.tum")
        if result.online is not None:
            write_tum(result.online, folder / "online.tum")
    if "kitti" in formats:
        write_kitti(result.trajectory, folder / "trajectory.kitti", frames=result.frames)
        write_kitti(keyframes, folder / "keyframes.kitti")
    if "ply" in formats:
        write_ply(result.points, folder / "map.ply", centres=keyframes.positions)
    if {"colmap", "colmap_images"} & set(formats):
        from prgbd.io.colmap_model import write_colmap

        write_colmap(result, folder / "colmap", frame if "colmap_images" in formats else None)
    write_json(folder / "slam.json", slam_figures(result))
    save_arrays(result, folder / "result.npz")


def slam_figures(result: SlamResult) -> dict[str, Any]:
    """Return what ``slam.json`` holds; ``docs/summary-schema.md`` says what it means."""
    states, counts = np.unique([str(s) for s in result.states], return_counts=True)
    return {
        "camera": result.camera.to_dict(),
        "mode": result.mode,
        "frames": result.frames,
        "tracked_frames": result.tracked_frames,
        "keyframes": len(result.keyframes),
        "maps": len(np.unique(result.keyframes.map_id)),
        "points": len(result.points),
        "observations": len(result.observations),
        "states": dict(zip(states.tolist(), counts.tolist(), strict=True)),
        "kitti_lines_filled": result.frames - result.tracked_frames,
        "stats": result.stats,
    }
