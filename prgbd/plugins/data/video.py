"""Any video file that FFmpeg reads as a recording."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.core.undistortion import Undistorter
from prgbd.io.naming import safe_name
from prgbd.io.reading import require_file, visible
from prgbd.plugins.data._camera import known_or_estimated
from prgbd.plugins.data._images import SUFFIXES as IMAGE_SUFFIXES
from prgbd.plugins.data._recording import VIDEO_SUFFIXES, check_index, choose, frame_range
from prgbd.plugins.data._repeats import without_repeats
from prgbd.plugins.data._video_reader import VideoReader

log = logging.getLogger("prgbd")


class VideoSequence(Sequence):
    """A video file. Every frame is identified by the packet that it was decoded from, in whatever order it is read.

    Pictures come out as players show them: upright and with square pixels.

    Args:
        root: The video file, or a folder of them.
        sequence: Name of the file within the folder; None for the only one.
        camera: A YAML file (``camera: {width, height, fx, fy, cx, cy, distortion}`` or ``fov_degrees``) or its content;
            None takes ``NAME.camera.yaml`` beside ``NAME.mp4``; where there is none, COLMAP estimates it (extra
            ``colmap``). It belongs to the video's own size.
        fov: Horizontal field of view in degrees, instead of ``camera``.
        width: Pixels of width to shrink the images to; None leaves them as they are.
        fps: Frames per second; None takes the times of the frames from the file.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.
        repeats: What happens to frames that repeat the one before, "leave_out" or "keep".

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If the file is absent or no readable video, or the camera file is malformed.
    """

    def __init__(
        self,
        root: str | Path,
        sequence: str | None = None,
        camera: str | Path | Mapping[str, Any] | None = None,
        fov: float | None = None,
        width: int | None = None,
        fps: float | None = None,
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
        repeats: Literal["leave_out", "keep"] = "leave_out",
    ) -> None:
        root = Path(root).expanduser()
        self._path = _find(root, sequence)
        self.name = _name(self._path, root)
        self._reader = VideoReader(self._path)
        if self._reader.interlaced:
            log.warning("%s is interlaced: one of the two fields of each picture is kept.", self._path)
        times = _times(self._reader, fps, self._path)
        chosen = self._range(start, stop, step)
        pinhole = self._camera(camera, fov, range(chosen[0], chosen[-1] + 1))
        self._size = _shrunk(width, *self._reader.size)
        pinhole = pinhole.resized(*self._size)
        self.camera = pinhole.undistorted()
        self._undistorter = Undistorter(pinhole)
        stay, self.remarks = without_repeats(
            lambda i: self._reader.read(chosen[i]), len(chosen), str(self._path), repeats, self._cheap(chosen)
        )
        self._chosen = np.array(chosen)[stay]
        self.timestamps = np.array(times[self._chosen], np.float64)

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the video files of the folder ``root``, or ``[None]`` for a single file.

        Raises:
            DataError: If there are none.
        """
        root = Path(options["root"]).expanduser()
        return list(_videos(root)) if root.is_dir() else [None]

    def frame(self, index: int) -> Frame:
        """Decode a frame.

        Raises:
            DataError: If the frame is damaged, or of another size than the first; the message names file and frame.
            IndexError: If the index is out of range.
        """
        check_index(index, len(self), self.name)
        image = self._reader.read(int(self._chosen[index]))
        if self._size != (image.shape[1], image.shape[0]):
            image = np.asarray(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA), np.uint8)
        return Frame(index, float(self.timestamps[index]), self._undistorter.image(image))

    def _range(self, start: int, stop: int | None, step: int) -> range:
        """Return the chosen frames; those at the end of the file that cannot be decoded do not count."""
        chosen = frame_range(len(self._reader), start, stop, step, self.name)
        if self._reader.can_decode(chosen[-1]):
            return chosen
        end = self._reader.decodable()
        if not 0 < end <= chosen[-1]:  # damage in the middle is named by the run, where it comes to it
            return chosen
        log.warning(
            "The last %d frame(s) of %s cannot be decoded and are left out.", len(self._reader) - end, self._path
        )
        return frame_range(end, start, stop, step, self.name)

    def _camera(self, camera: str | Path | Mapping[str, Any] | None, fov: float | None, span: range) -> PinholeCamera:
        """Return the camera of the pictures, which have square pixels, and say so where the file's have not."""
        size, stored = self._reader.size, self._reader.stored
        beside = self._path.with_suffix(".camera.yaml")

        def known(image: Callable[[int], NDArray[np.uint8]]) -> PinholeCamera:
            return known_or_estimated(camera, fov, beside, self._path, image, len(span)).resized(*size)

        if size == stored:
            return known(lambda i: self._reader.read(span[i]))
        log.warning(
            "The pixels of %s are not square: its pictures of %dx%d are scaled to %dx%d. A camera file may be that of "
            "either size.",
            *(self._path, *stored, *size),
        )
        found = []
        if fov is None and (camera is not None or beside.is_file()):
            blank = np.zeros((stored[1], stored[0], 3), np.uint8)
            with suppress(DataError):  # it is of the scaled pictures
                found.append(known(lambda _: blank))
            with suppress(DataError):
                found.append(known(lambda i: self._reader.read(span[i])))
        # Without a size in the file, it is that at which the pixels come out square.
        return min(found, key=_skew) if found else known(lambda i: self._reader.read(span[i]))

    def _cheap(self, chosen: range) -> Callable[[int], int]:
        """Return a function that tells the chosen frame nearest to a given one that is cheap to begin at."""
        return lambda i: max(0, -((chosen.start - self._reader.cheap_start(chosen[i])) // chosen.step))


def _times(reader: VideoReader, fps: float | None, path: Path) -> NDArray[np.float64]:
    """Return the time of every frame in seconds."""
    if fps is None and reader.index.timed:
        return reader.index.times
    rate = reader.index.rate if fps is None else fps
    if not (np.isfinite(rate) and rate > 0):
        raise ConfigError(f"The frame rate of {path} is {rate:g}; set the option data.fps to its frames per second.")
    if fps is None:
        log.warning("%s does not say when its frames were taken; set data.fps if it is not %g a second.", path, rate)
    return np.arange(len(reader)) / rate


def _skew(camera: PinholeCamera) -> float:
    return float(abs(np.log(camera.fx / camera.fy)))


def _shrunk(width: int | None, full_width: int, full_height: int) -> tuple[int, int]:
    """The size of the images, (width, height), with the width that was asked for."""
    if width is None:
        return full_width, full_height
    if isinstance(width, bool) or not isinstance(width, int) or not 16 <= width <= full_width:
        raise ConfigError(
            f"data.width={width} cannot be used; images can be shrunk to a width of 16 to {full_width} pixels."
        )
    return width, max(1, round(full_height * width / full_width))


def _videos(folder: Path) -> list[str]:
    found = [path.name for path in visible(folder, VIDEO_SUFFIXES)]
    if not found:
        mend = "take data=images for its images" if visible(folder, IMAGE_SUFFIXES) else "check the option data.root"
        raise DataError(f"The folder {folder} has no videos ({', '.join(VIDEO_SUFFIXES[:4])}, ...); {mend}.")
    return found


def _name(path: Path, root: Path) -> str:
    """Return a name that no other video of the folder has, though it may differ in its suffix alone."""
    alike = root.is_dir() and [Path(name).stem for name in _videos(root)].count(path.stem) > 1
    return safe_name(path.name if alike else path.stem)


def _find(root: Path, sequence: str | None) -> Path:
    if root.is_dir():
        return root / choose(sequence, _videos(root), root)
    if not root.exists():
        raise DataError(f"There is no video file {root}; check the option data.root.")
    require_file(root, "the video of data.root")
    if sequence is not None and sequence not in (root.name, root.stem):
        raise DataError(f"There is no sequence '{sequence}' in the single video {root}; leave data.sequences empty.")
    return root
