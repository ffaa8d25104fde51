"""What the recordings on disk have in common: a list of files, a range of frames, poses and depth read on demand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.core.undistortion import Undistorter
from prgbd.plugins.data._depth_files import DepthFormat, DepthReader
from prgbd.plugins.data._images import common_levels, read_image
from prgbd.plugins.data._repeats import without_repeats

ARCHIVES = (".zip", ".tgz", ".tar.gz", ".tar")
VIDEO_SUFFIXES = (
    *(".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".mts", ".m2ts", ".ts", ".ogv", ".wmv", ".flv"),
    *(".3gp", ".gif", ".mjpg", ".mjpeg", ".h264", ".hevc"),
)


@dataclass
class Files:
    """The frames of a recording as parallel lists; everything but images and time stamps may be absent.

    Attributes:
        images: Image files.
        timestamps: (N,) seconds.
        depths: Depth files, None for frames without; None if the recording has none.
        rights: Right images likewise.
        poses: (N, 4, 4) ``wTc`` with NaN where unknown.
        depth_format: What the numbers in the depth files mean.
    """

    images: list[Path]
    timestamps: NDArray[np.float64]
    depths: list[Path | None] | None = None
    rights: list[Path | None] | None = None
    poses: NDArray[np.float64] | None = None
    depth_format: DepthFormat = field(default_factory=DepthFormat)

    def chosen(self, keep: range | NDArray[np.int64]) -> Files:
        """Return the frames of these numbers."""
        index = np.array(keep)
        return Files(
            [self.images[i] for i in keep],
            self.timestamps[index],
            None if self.depths is None else [self.depths[i] for i in keep],
            None if self.rights is None else [self.rights[i] for i in keep],
            None if self.poses is None else self.poses[index],
            self.depth_format,
        )


class FileSequence(Sequence):
    """A recording of one file per image. A subclass finds the files and calls this constructor.

    Args:
        name: As in ``Sequence``.
        camera: The camera with its distortion; ``self.camera`` is the one without.
        files: All frames of the recording.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

    Raises:
        ConfigError: If the range of frames is empty or malformed.
        DataError: If the time stamps do not ascend.
    """

    concurrent = True

    def __init__(
        self, name: str, camera: PinholeCamera, files: Files, start: int = 0, stop: int | None = None, step: int = 1
    ) -> None:
        self.name = name
        self.camera = camera.undistorted()
        self._undistorter = Undistorter(camera)
        # Of all images, so that a part of the recording looks as it does in the whole.
        self._levels, understood = common_levels(files.images)
        if understood:
            self.remarks = (*self.remarks, understood)
        self._files = files.chosen(frame_range(len(files.images), start, stop, step, name))
        if files.depths is not None:
            self.depth_levels_per_metre = files.depth_format.levels_in(files.depths)
        self._depths = DepthReader(name, (camera.width, camera.height), files.depth_format)
        self.timestamps = np.asarray(self._files.timestamps, np.float64)
        bad = np.flatnonzero(~(np.diff(self.timestamps) > 0))
        if len(bad) or not np.isfinite(self.timestamps).all():
            where = f" behind {self._files.images[bad[0]].name}" if len(bad) else ""
            raise DataError(f"The time stamps of the recording '{name}' do not ascend{where}; check its list of times.")

    def leave_out_repeats(self, repeats: str) -> None:
        """Drop the frames that repeat the one before, unless ``repeats`` is "keep"."""
        stay, said = without_repeats(lambda i: self.frame(i).image, len(self), self.name, repeats)
        self._files = self._files.chosen(stay)
        self.timestamps = self.timestamps[stay]
        self.remarks = (*self.remarks, *said)

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """True poses ``wTc``, (N, 4, 4) float64 with NaN where unknown, or None."""
        return self._files.poses

    def frame(self, index: int) -> Frame:
        """Read a frame.

        Raises:
            DataError: If a file cannot be read; the message names it.
            IndexError: If the index is out of range.
        """
        check_index(index, len(self), self.name)
        size = (self.camera.width, self.camera.height)
        image = self._undistorter.image(read_image(self._files.images[index], size, self._levels))
        right = None if self._files.rights is None else self._files.rights[index]
        depth = None
        if self._files.depths is not None:  # a sensor's; what a subclass knows of the truth stays out of the frame
            depth = self.depth(index)
            depth = np.zeros(image.shape[:2], np.float32) if depth is None else depth
        right_image = None if right is None else read_image(right, size, self._levels)
        return Frame(index, float(self.timestamps[index]), image, depth, right_image)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Read the depth of a frame, (H, W) float32 metres with 0 where unknown, or None.

        Raises:
            DataError: If the file cannot be read; the message names it.
        """
        path = None if self._files.depths is None else self._files.depths[index]
        if path is None:
            return None
        return self._undistorter.depth(self._depths.read(path))


def check_index(index: int, length: int, name: str) -> None:
    """Raise ``IndexError`` unless 0 <= index < length."""
    if not 0 <= index < length:
        raise IndexError(f"Frame {index} of '{name}' is out of range; it has {length} frames.")


def frame_range(count: int, start: int, stop: int | None, step: int, name: str) -> range:
    """Return the chosen frames out of ``count``.

    Raises:
        ConfigError: If a value is negative or no frame remains.
    """
    if start < 0 or step < 1 or (stop is not None and stop < 0):
        raise ConfigError(
            f"The range of frames start={start}, stop={stop}, step={step} is malformed; start and stop count "
            "from 0 and step from 1."
        )
    chosen = range(start, count if stop is None else min(stop, count), step)
    if not chosen:
        raise ConfigError(
            f"The range of frames start={start}, stop={stop}, step={step} leaves none of the {count} frames of "
            f"'{name}'."
        )
    return chosen


def existing_root(root: str | Path) -> Path:
    """Return the root folder.

    Raises:
        DataError: If it is absent.
    """
    path = Path(root).expanduser()
    if path.is_file():
        mend = "for a video take data=video" if path.suffix.lower() in VIDEO_SUFFIXES else "give the folder it lies in"
        raise DataError(f"{path} is a file, and data.root must be a folder; {mend}.")
    if not path.is_dir():
        raise DataError(f"There is no folder {path}; check the option data.root.")
    return path


def or_unpack(folder: Path, mend: str) -> str:
    """Return the mend for a folder without recordings: its archives, if any, are to be unpacked first."""
    packed = sorted(p for pattern in ("*", "*/*") for p in folder.glob(pattern) if p.name.lower().endswith(ARCHIVES))
    return f"unpack {packed[0].relative_to(folder)} where it lies" if packed else mend


def choose(sequence: str | None, names: Iterable[str], root: Path) -> str:
    """Return the chosen recording; None chooses the only one.

    Raises:
        DataError: If the name is unknown or None is ambiguous; the message lists what there is.
    """
    known = list(names)
    listed = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    if sequence is None and len(known) == 1:
        return known[0]
    if sequence is None:
        raise DataError(f"{root} holds {len(known)} sequences; choose from {listed}.")
    if sequence not in known:
        raise DataError(f"There is no sequence '{sequence}' in {root}; there are {listed}.")
    return sequence


def as_poses(rows: NDArray[np.float64], source: Path) -> NDArray[np.float64]:
    """Return (N, 4, 4) poses from (N, 12) row-major 3x4 matrices, their rotations made exactly orthonormal.

    Raises:
        DataError: If a matrix is not finite or no rigid transform.
    """
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    finite = np.isfinite(poses).all(axis=(1, 2))
    if not finite.all():
        raise DataError(f"Pose {int(np.argmin(finite))} of {source} is not finite; check the file.")
    u, s, vt = np.linalg.svd(poses[:, :3, :3])
    rigid = (np.abs(s - 1) < 0.02).all(axis=1) & (np.linalg.det(poses[:, :3, :3]) > 0)
    if not rigid.all():
        raise DataError(f"Pose {int(np.argmin(rigid))} of {source} is no rigid transform; check the file.")
    poses[:, :3, :3] = u @ vt
    return poses
