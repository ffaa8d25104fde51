"""What SLAM found out, written to files that other programs read: npz, TUM, KITTI, PLY and COLMAP's text.

The heavy libraries are imported where they are used, so this module is cheap to import.
"""

from __future__ import annotations

import difflib
import json
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError, DataError
from prgbd.core.files import atomic_path, to_plain, write_json
from prgbd.core.types import Frame, Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory

if TYPE_CHECKING:
    from evo.core.trajectory import PoseTrajectory3D

FORMAT = 1
FORMATS = ("tum", "kitti", "ply", "colmap", "colmap_images")
DEFAULT_FORMATS = ("tum", "kitti", "ply")
CAMERA_COLOUR = (255, 128, 0)


def save_slam_result(result: SlamResult, path: Path | str) -> None:
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


def load_slam_result(path: Path | str) -> SlamResult:
    """Read what ``save_slam_result`` wrote.

    Raises:
        DataError: If the file is missing, truncated, or not a SLAM result.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(f"There is no SLAM result {path}; run SLAM first.")
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _result_from(arrays)
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise DataError(
            f"{path} is not a whole SLAM result ({type(error).__name__}: {error}); delete it and run SLAM again."
        ) from error


def _result_from(arrays: dict[str, NDArray[Any]]) -> SlamResult:
    header = json.loads(str(arrays["header"]))
    if header["format"] != FORMAT:
        raise ValueError(f"format {header['format']} instead of {FORMAT}")
    camera = header["camera"]

    def part(prefix: str) -> dict[str, NDArray[Any]]:
        return {k.split(".", 1)[1]: v for k, v in arrays.items() if k.startswith(prefix + ".")}

    online = part("online")
    return SlamResult(
        camera=PinholeCamera(**{**camera, "distortion": tuple(camera["distortion"])}),
        mode=header["mode"],
        frames=header["frames"],
        trajectory=Trajectory(**part("trajectory")),
        keyframes=Keyframes(**part("keyframes")),
        points=MapPoints(**part("points")),
        observations=Observations(**part("observations")),
        states=[str(s) for s in arrays["states"]],
        inliers=arrays["inliers"],
        online=Trajectory(**online) if online else None,
        stats=header["stats"],
    )


def to_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    """Return the trajectory as evo's ``PoseTrajectory3D``.

    Raises:
        DataError: If the trajectory has no poses, which evo cannot hold.
    """
    from evo.core.trajectory import PoseTrajectory3D

    if len(trajectory) == 0:
        raise DataError("The trajectory has no poses, so there is nothing to compare; check that tracking initialised.")
    return PoseTrajectory3D(poses_se3=list(trajectory.wTc), timestamps=trajectory.timestamp)


def keyframe_trajectory(keyframes: Keyframes) -> Trajectory:
    """Return the keyframes' poses as a trajectory."""
    return Trajectory(keyframes.frame_index, keyframes.timestamp, keyframes.wTc)


def write_tum(trajectory: Trajectory, path: Path | str) -> None:
    """Write ``timestamp tx ty tz qx qy qz qw`` lines (seconds, metres, camera-to-world), one per pose."""
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        file.write("# timestamp tx ty tz qx qy qz qw\n")
        if len(trajectory):
            from evo.tools.file_interface import write_tum_trajectory_file

            write_tum_trajectory_file(file, to_evo(trajectory))


def read_tum(
    path: Path | str, timestamps: NDArray[np.float64] | None = None, max_difference: float = 0.02
) -> Trajectory:
    """Read a TUM trajectory file.

    Args:
        path: The file; lines that start with ``#`` are skipped, the first of several poses of one time is kept, and
            poses are sorted by time.
        timestamps: (F,) seconds of the frames that the poses belong to, ascending. Each frame then takes the nearest
            pose in time, and ``frame_index`` and ``timestamp`` are the frame's. Without it poses are numbered in order.
        max_difference: Largest difference in seconds for which a pose belongs to a frame.

    Raises:
        DataError: If the file is missing or malformed.
    """
    from scipy.spatial.transform import Rotation

    rows = _read_numbers(Path(path), 8)
    if len(rows) == 0:
        return Trajectory.empty()
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]  # motion-capture files repeat some time stamps
    if np.any(np.linalg.norm(rows[:, 4:], axis=1) < 1e-6):
        raise DataError(f"{path} has a quaternion of length zero; columns 5-8 must be qx qy qz qw.")
    wTc = np.tile(np.eye(4), (len(rows), 1, 1))
    wTc[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
    wTc[:, :3, 3] = rows[:, 1:4]
    if timestamps is None:
        return Trajectory(np.arange(len(rows)), rows[:, 0], wTc)
    frames, poses = match_times(np.asarray(timestamps, np.float64), rows[:, 0], max_difference)
    return Trajectory(frames, np.asarray(timestamps, np.float64)[frames], wTc[poses])


def match_times(
    frames: NDArray[np.float64], poses: NDArray[np.float64], max_difference: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows ``(frame, pose)`` of each frame time and the pose time nearest to it, if near enough (seconds)."""
    if len(poses) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    after = np.minimum(np.searchsorted(poses, frames), len(poses) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(poses[before] - frames) <= np.abs(poses[after] - frames), before, after)
    keep = np.flatnonzero(np.abs(poses[nearest] - frames) <= max_difference)
    return keep.astype(np.int64), nearest[keep].astype(np.int64)


def write_kitti(trajectory: Trajectory, path: Path | str, frames: int | None = None) -> int:
    """Write one line of 12 numbers (the first three rows of ``wTc``) per frame.

    The format has no time stamps, so every frame needs a line. A frame without a pose gets one between its nearest
    tracked neighbours, linear in the frame number (rotation by slerp); before the first and after the last tracked
    frame the pose is held; without any pose all lines are the identity.

    Args:
        trajectory: The poses.
        path: The file.
        frames: Number of frames of the sequence; None writes one line per pose and fills nothing.

    Returns:
        How many lines were filled in rather than tracked.

    Raises:
        DataError: If a pose belongs to a frame beyond ``frames``.
    """
    poses = trajectory.wTc if frames is None else fill_poses(trajectory, frames)
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        if len(poses):
            from evo.core.trajectory import PosePath3D
            from evo.tools.file_interface import write_kitti_poses_file

            write_kitti_poses_file(file, PosePath3D(poses_se3=list(poses)))
    return len(poses) - len(trajectory)


def fill_poses(trajectory: Trajectory, frames: int) -> NDArray[np.float64]:
    """Return (frames, 4, 4) poses ``wTc``, interpolated or held where the trajectory has none (see ``write_kitti``)."""
    from scipy.spatial.transform import Rotation, Slerp

    known = np.asarray(trajectory.frame_index, np.float64)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    if len(known) == 0:
        return poses
    if known[-1] >= frames or known[0] < 0:
        raise DataError(
            f"The trajectory has a pose for frame {int(known[-1])} of {frames}; give the sequence's length."
        )
    wanted = np.clip(np.arange(frames), known[0], known[-1])
    for axis in range(3):
        poses[:, axis, 3] = np.interp(wanted, known, trajectory.wTc[:, axis, 3])
    rotations = Rotation.from_matrix(trajectory.wTc[:, :3, :3])
    poses[:, :3, :3] = (
        Slerp(known, rotations)(wanted) if len(known) > 1 else rotations[np.zeros(frames, int)]
    ).as_matrix()
    poses[trajectory.frame_index] = trajectory.wTc  # tracked poses stay as they are, to the last bit
    return poses


def read_kitti(path: Path | str, timestamps: NDArray[np.float64] | None = None) -> Trajectory:
    """Read a KITTI pose file, one line per frame; time stamps are 0, 1, 2, ... unless given, (N,) seconds.

    Raises:
        DataError: If the file is missing or malformed, or has another number of lines than ``timestamps``.
    """
    rows = _read_numbers(Path(path), 12)
    if timestamps is not None and len(timestamps) != len(rows):
        raise DataError(
            f"{path} has {len(rows)} poses for {len(timestamps)} time stamps; use the files of one sequence."
        )
    wTc = np.tile(np.eye(4), (len(rows), 1, 1))
    wTc[:, :3] = rows.reshape(-1, 3, 4)
    stamps = np.arange(len(rows), dtype=np.float64) if timestamps is None else np.asarray(timestamps, np.float64)
    return Trajectory(np.arange(len(rows)), stamps, wTc)


def _read_numbers(path: Path, columns: int) -> NDArray[np.float64]:
    """Read a text file of ``columns`` finite numbers per line, (N, columns); ``#`` starts a comment line."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"Cannot read the poses {path} ({error}); check that the path is right.") from error
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != columns or not np.isfinite(row).all():
            raise DataError(f"{path}, line {number}, is not {columns} finite numbers; check that the file is complete.")
        rows.append(row)
    if not text.strip():
        raise DataError(f"{path} is empty; a pose file has lines of {columns} numbers.")
    return np.array(rows, np.float64).reshape(-1, columns)


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
    """Return the formats of ``write_slam_folder`` without repeats.

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


def write_slam_folder(
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
        ConfigError: If a format is unknown, or ``colmap_images`` is asked for without ``frame``.
    """
    formats = check_formats(formats)
    if "colmap_images" in formats and frame is None:
        raise ConfigError("The format colmap_images needs the frames; give frame=sequence.frame, or use colmap.")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
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
        from prgbd.core.colmap import write_colmap

        write_colmap(result, folder / "colmap", frame if "colmap_images" in formats else None)
    write_json(folder / "slam.json", slam_figures(result))
    save_slam_result(result, folder / "result.npz")


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
