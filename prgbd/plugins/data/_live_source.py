"""What gives pictures as time goes by: a camera, a stream, or a video file that is played at its own rate."""

from __future__ import annotations

import re
import stat
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.plugins.data._video_picture import Pictures

GAP = 10.0  # seconds by which a source's time may leave the computer's before it counts as another clock
OPEN, READ = 10.0, 5.0  # seconds after which a stream that is silent counts as lost
DEVICE = "video4linux2"
_URL = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]*://")
_ACCESS = re.compile(r"(?<=://)[^@/]*@")  # name and password in an address, which no message should repeat


@dataclass
class Tally:
    """What became of a source's pictures besides those that were yielded.

    Attributes:
        damaged: Number of those that could not be decoded.
        ended: What ended it, in words that follow "ended".
    """

    damaged: int = 0
    ended: str = "with the source"


class LiveSource:
    """A source of pictures that is open.

    Args:
        root: The number of a camera (0 is ``/dev/video0``) or its device, the address of a stream (``rtsp://...``), or
            a video file, which is played at its own rate as a rehearsal.
        options: FFmpeg's options for it, such as ``{"video_size": "1280x720", "framerate": 30}``.

    Attributes:
        name: What messages call it; without a password.
        tally: What became of the pictures so far.

    Raises:
        DataError: If it is absent or cannot be opened.
    """

    def __init__(self, root: str | int | Path, options: Mapping[str, Any]) -> None:
        address, form, self._paced = _meant(root)
        self.name = _ACCESS.sub("", address)
        self.tally = Tally()
        try:
            self._container = av.open(
                address,
                format=form,
                options={**_confined(self._paced), **{key: str(value) for key, value in options.items()}},
                timeout=(OPEN, READ),
                metadata_errors="replace",
            )
            stream = next(iter(self._container.streams.video), None)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise DataError(f"{self.name} cannot be opened ({_reason(error)}); {_mend(error, form)}.") from error
        if stream is None:
            raise DataError(f"{self.name} gives no pictures; check data.root.")
        self._stream: Any = stream
        self._stream.thread_type = "SLICE"  # a thread per frame would hold frames back

    def pictures(self, stop: Event) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Yield the time in nanoseconds since 1970 and the picture, (H, W, 3) uint8 RGB, as they come.

        Times are those that the source gives, from the first one on, which is the computer's; where they lack, go back
        or jump, the computer's.

        Args:
            stop: Ends it when set.
        """
        shower = Pictures(float(self._stream.sample_aspect_ratio or 1))
        clock = _SourceClock()
        try:
            for frame in self._frames(stop):
                if self._paced and frame.time is not None and stop.wait(clock.until(frame.time)):
                    return
                yield clock.stamp(frame.time), shower.picture(frame)
        except (av.error.FFmpegError, OSError) as error:
            self.tally.ended = f"as the source was lost ({_reason(error)})"
        finally:
            self._container.close()

    def _frames(self, stop: Event) -> Iterator[Any]:
        """Yield decoded frames and count those that are damaged."""
        for packet in self._container.demux(self._stream):
            if stop.is_set():
                return
            try:
                frames = packet.decode()
            except av.error.InvalidDataError:
                self.tally.damaged += 1
                continue
            for frame in frames:
                if frame.is_corrupt:
                    self.tally.damaged += 1
                else:
                    yield frame


class _SourceClock:
    """The computer's time at the first picture, and the source's from there on."""

    def __init__(self) -> None:
        self._first: float | None = None
        self._began, self._begin, self._last = 0.0, 0, 0

    def until(self, seconds: float) -> float:
        """Return how many seconds it is until a picture of a source's time is due; nobody waits for one far ahead."""
        wait = 0.0 if self._first is None else self._began + seconds - self._first - time.monotonic()
        return wait if 0 < wait < GAP else 0.0

    def stamp(self, seconds: float | None) -> int:
        """Return the time of a picture that comes now, in nanoseconds since 1970, later than the one before."""
        stamp, now = 0, time.time_ns()
        if self._first is not None and seconds is not None:
            stamp = self._begin + round((seconds - self._first) * 1e9)
        if stamp <= self._last or abs(stamp - now) > GAP * 1e9:  # the first one, or a stream whose clock was set
            stamp, self._first, self._began, self._begin = now, seconds, time.monotonic(), now
        self._last = max(stamp, self._last + 1)
        return self._last


def _confined(file: bool) -> dict[str, str]:
    """Return the options that keep a file from leading elsewhere, as a play list does."""
    return {"protocol_whitelist": "file"} if file else {}


def _meant(root: str | int | Path) -> tuple[str, str | None, bool]:
    """Return what FFmpeg opens, its format where it must be told, and whether it is played at its own rate."""
    text = str(root)
    if _URL.match(text):
        return text, None, text.startswith("file://")
    path = Path(f"/dev/video{text}") if text.isdigit() else Path(text).expanduser()
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        known = ", ".join(sorted(str(device) for device in Path("/dev").glob("video*"))) or "none"
        raise DataError(
            f"There is no camera or video {path} (cameras of this computer: {known}); set data.root to the number of a "
            "camera, the address of a stream, or a video file."
        ) from None
    if stat.S_ISCHR(mode):
        return str(path), DEVICE, False
    if not stat.S_ISREG(mode):
        raise DataError(f"{path} is neither a camera nor a file; for a folder of images take data=images.")
    return str(path.absolute()), None, True


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)


def _mend(error: Exception, form: str | None) -> str:
    if isinstance(error, PermissionError):
        return "give yourself access, for a camera by the group 'video'"
    if form == DEVICE:
        return "another program may use it, or it may lack what data.options ask for"
    return "check the address or the file of data.root"
