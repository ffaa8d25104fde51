"""Any video file that OpenCV reads as a recording."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.types import Frame
from prgbd.io.naming import safe_name
from prgbd.plugins.data._camera import Undistorter, known_or_estimated
from prgbd.plugins.data._images import SUFFIXES as IMAGE_SUFFIXES
from prgbd.plugins.data._mp4 import frame_times
from prgbd.plugins.data._recording import VIDEO_SUFFIXES, check_index, choose, frame_range

log = logging.getLogger("prgbd")

SKIP = 48  # up to so many frames are decoded and dropped rather than sought
UNEVEN = 2e-3  # seconds by which frames may last unequally long
PROBE = 12  # frame by which seeking is tested


class VideoSequence(Sequence):
    """A video file. Frames read in order are decoded once; others are sought if the file's seeking proves exact.

    Args:
        root: The video file, or a folder of them.
        sequence: Name of the file within the folder; None for the only one.
        camera: A YAML file (``camera: {width, height, fx, fy, cx, cy, distortion}`` or ``fov_degrees``) or its content;
            None takes ``NAME.camera.yaml`` beside ``NAME.mp4``; where there is none, COLMAP estimates it (extra
            ``colmap``). It belongs to the video's own size.
        fov: Horizontal field of view in degrees, instead of ``camera``.
        width: Pixels of width to shrink the images to; None leaves them as they are.
        fps: Frames per second; None takes the file's, and the times of its frames where they are listed (MP4, MOV).
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

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
    ) -> None:
        self._path = _find(Path(root).expanduser(), sequence)
        self._reader = _Reader(self._path)
        first = self._reader.read(0)
        rate = self._reader.rate if fps is None else fps
        if not (np.isfinite(rate) and rate > 0):
            raise ConfigError(
                f"The frame rate of {self._path} is {rate:g}; set the option data.fps to its frames per second."
            )
        self.name = safe_name(self._path.stem)
        count = self._reader.count()
        self._chosen = frame_range(count, start, stop, step, self.name)
        beside = self._path.with_suffix(".camera.yaml")
        span = range(self._chosen[0], self._chosen[-1] + 1)
        pinhole = known_or_estimated(camera, fov, beside, self._path, lambda i: self._reader.read(span[i]), len(span))
        self._size = _shrunk(width, first.shape[1], first.shape[0])
        pinhole = pinhole.resized(*self._size)
        self._full = first.shape
        self.camera = pinhole.undistorted()
        self._undistorter = Undistorter(pinhole)
        times = np.arange(count) / rate
        if fps is None and self._reader.times is not None and len(self._reader.times) >= count:
            times = self._reader.times[:count]
        self.timestamps = np.array(times[np.array(self._chosen)], np.float64)

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
            DataError: If the video ends before or the frame is damaged; the message names file and frame.
            IndexError: If the index is out of range.
        """
        check_index(index, len(self), self.name)
        image = self._reader.read(self._chosen[index])
        if image.shape != self._full:
            raise DataError(
                f"Frame {self._chosen[index]} of {self._path} has another size than the first; cut the video."
            )
        if self._size != (image.shape[1], image.shape[0]):
            image = np.asarray(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA), np.uint8)
        return Frame(index, float(self.timestamps[index]), self._undistorter.image(image))


class _Reader:
    """Reads frames of a file by number. A copy in another process opens the file for itself."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._capture: Any = None
        self._owner = 0
        self._next = 0
        self._last: tuple[int, NDArray[np.uint8]] | None = None
        self._seeks: bool | None = None
        self._count: int | None = None
        self.times = frame_times(path)
        self._even = self.times is None or len(self.times) < 3 or bool(np.ptp(np.diff(self.times)) < UNEVEN)
        self.rate = float(self._open().get(cv2.CAP_PROP_FPS))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_capture": None, "_last": None}

    def read(self, number: int) -> NDArray[np.uint8]:
        """Return frame ``number``, (H, W, 3) uint8 RGB.

        Raises:
            DataError: If it cannot be decoded.
        """
        if self._capture is None or self._owner != os.getpid():
            # A file position shared between processes would mix up their frames.
            self._open()
        if self._last is not None and self._last[0] == number:
            return self._last[1].copy()
        self._go_to(number)
        done, image = self._capture.read()
        if not done or image is None:
            self._capture = None
            if number == 0:
                raise DataError(f"{self._path} has no frame that can be decoded; convert it, e.g. to MP4.")
            raise DataError(
                f"Frame {number} of {self._path} cannot be decoded; the file is damaged or shorter than it says: set "
                f"data.stop to {number} or less."
            )
        self._next = number + 1
        rgb = np.ascontiguousarray(_three_channels(image)[..., ::-1])
        self._last = (number, rgb)
        return rgb.copy()

    def count(self) -> int:
        """Return the number of frames that can be decoded.

        What the container says is taken if the last of these frames can be read; otherwise they are counted.
        """
        if self._count is None:
            self._count = self._counted()
        return self._count

    def _counted(self) -> int:
        claimed = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if claimed > 0 and self._can_seek():
            try:
                self.read(claimed - 1)
                return claimed
            except DataError:
                pass
        self._open()
        number = 0
        while self._capture.grab():
            number += 1
        self._open()
        if claimed > number:
            log.warning("%s says it has %d frames, but ends after %d.", self._path, claimed, number)
        return number

    def _open(self) -> Any:
        """Open the file anew at its first frame and return it."""
        self._capture = None
        capture = cv2.VideoCapture(str(self._path))
        if not capture.isOpened():
            raise DataError(f"{self._path} is no video that OpenCV can read, or is truncated; convert it, e.g. to MP4.")
        self._capture, self._owner, self._next, self._last = capture, os.getpid(), 0, None
        return capture

    def _go_to(self, number: int) -> None:
        """Bring the file to where the next decoded frame is ``number``."""
        if not 0 <= number - self._next <= SKIP:
            if self._can_seek():
                self._seek(number)
            elif number < self._next:
                self._open()
        while self._next < number and self._capture.grab():
            self._next += 1

    def _seek(self, number: int) -> None:
        """Bring the file to frame ``number``, or to one before it where frames last unequally long.

        OpenCV seeks by time at the mean frame rate, so where it came out is read off the next frame's time.
        """
        if self._even or self.times is None:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
            self._next = number
            return
        for back in (2, 60):
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, max(0, round(self.times[number] * self.rate) - back))
            if not self._capture.grab():
                continue
            at = int(np.argmin(np.abs(self.times - self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)))
            if at < number:
                self._next = at + 1
                return
        self._open()

    def _can_seek(self) -> bool:
        """Test once whether a sought frame equals the same frame decoded in order."""
        if self._seeks is None:
            probe = cv2.VideoCapture(str(self._path))
            frames = []
            for _ in range(PROBE):
                done, image = probe.read()
                if not done:
                    break
                frames.append(image)
            number = len(frames) // 2
            probe.set(cv2.CAP_PROP_POS_FRAMES, number)
            done, image = probe.read()
            self._seeks = bool(frames) and done and np.array_equal(image, frames[number])
            probe.release()
        return self._seeks


def _shrunk(width: int | None, full_width: int, full_height: int) -> tuple[int, int]:
    """The size of the images, (width, height), with the width that was asked for."""
    if width is None:
        return full_width, full_height
    if isinstance(width, bool) or not isinstance(width, int) or not 16 <= width <= full_width:
        raise ConfigError(
            f"data.width={width} cannot be used; images can be shrunk to a width of 16 to {full_width} pixels."
        )
    return width, max(1, round(full_height * width / full_width))


def _three_channels(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image[..., :3]


def _videos(folder: Path) -> list[str]:
    found = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in VIDEO_SUFFIXES)
    if not found:
        images = any(p.suffix.lower() in IMAGE_SUFFIXES for p in folder.iterdir())
        mend = "take data=images for its images" if images else "check the option data.root"
        raise DataError(f"The folder {folder} has no videos ({', '.join(VIDEO_SUFFIXES[:4])}, ...); {mend}.")
    return found


def _find(root: Path, sequence: str | None) -> Path:
    if root.is_dir():
        return root / choose(sequence, _videos(root), root)
    if not root.is_file():
        raise DataError(f"There is no video file {root}; check the option data.root.")
    if sequence is not None and sequence not in (root.name, root.stem):
        raise DataError(f"There is no sequence '{sequence}' in the single video {root}; leave data.sequences empty.")
    return root
