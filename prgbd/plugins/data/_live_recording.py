"""A folder of pictures that is filled while a camera runs: what comes is kept, what is too much is counted."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.io.disk import writing
from prgbd.io.files import read_json, write_json
from prgbd.plugins.data._live_source import LiveSource

NOTE = "recording.json"
WAITING = 16  # pictures that wait to be written; more are dropped
QUALITY = 95  # of JPEG
COMPRESSION = 1  # of PNG: the quickest
PATIENCE = 0.05  # seconds between two looks at the clock
CLOSING = 2.0  # seconds that a source is given to close

Picture = tuple[int, NDArray[np.uint8]]


@dataclass(frozen=True)
class Recorded:
    """What is known of a recording, as in ``recording.json``.

    Attributes:
        source: Where it came from.
        frames: Number of pictures that were kept.
        dropped: Number of pictures that came while too many waited to be written.
        damaged: Number of pictures that could not be decoded.
        seconds: How long it took.
        ended: What ended it, in words that follow "ended".
    """

    source: str
    frames: int
    dropped: int
    damaged: int
    seconds: float
    ended: str

    @property
    def losses(self) -> str:
        """What is missing, in words."""
        damaged = f", {self.damaged} damaged" if self.damaged else ""
        return f"{self.dropped} dropped{damaged}"


def record(source: LiveSource, folder: Path, frames: int | None, seconds: float | None, lossless: bool) -> Recorded:
    """Keep the pictures of a source in a folder until it ends, a limit is reached, or Ctrl-C is pressed.

    A thread takes them at the rate at which they come; this one writes them, each file whole or not at all, named by
    its time in nanoseconds. Those that wait when the end comes are written too.

    Args:
        source: The source.
        folder: The folder; made if needed.
        frames: How many pictures to keep at most; None for no limit.
        seconds: How long to record at most; None for no limit.
        lossless: Write PNG rather than JPEG.

    Raises:
        DiskError: If the disk is full, or may not be written to; what was written stays.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    taker, begin, kept, ended = _Taker(source), time.monotonic(), 0, ""
    with _interrupting(taker):
        taker.start()
        try:
            while not ended:
                if (picture := taker.next(PATIENCE)) is not None:
                    _write(folder, picture, lossless)
                    kept += 1
                if frames is not None and kept >= frames:
                    ended = f"after {kept} frames"
                elif taker.interrupted:
                    ended = "by Ctrl-C"
                elif seconds is not None and time.monotonic() - begin >= seconds:
                    ended = f"after {seconds:g} s"
                elif picture is None and not taker.is_alive():
                    ended = source.tally.ended
        finally:
            taker.stop.set()
            taker.join(CLOSING)
        while (frames is None or kept < frames) and (picture := taker.next()) is not None:
            _write(folder, picture, lossless)
            kept += 1
    if taker.failure is not None:
        raise taker.failure
    took = round(time.monotonic() - begin, 3)
    recorded = Recorded(source.name, kept, taker.dropped, source.tally.damaged, took, ended)
    if kept:
        write_json(folder / NOTE, asdict(recorded))
    else:
        with contextlib.suppress(OSError):  # something else lies in it
            folder.rmdir()
    return recorded


def read_note(folder: Path) -> Recorded | None:
    """Return what is known of a recording, None if it broke off or its note is damaged."""
    with contextlib.suppress(DataError, TypeError):
        return Recorded(**read_json(folder / NOTE))
    return None


class _Taker(threading.Thread):
    """Takes pictures as they come; a queue that is full loses them.

    Attributes:
        stop: Ends it when set.
        interrupted: Whether Ctrl-C was pressed.
        dropped: Number of pictures that found the queue full.
        failure: What it died of, if it did.
    """

    def __init__(self, source: LiveSource) -> None:
        super().__init__(name="camera", daemon=True)  # a source that does not answer must not hold the program
        self._source = source
        self._queue: Queue[Picture] = Queue(WAITING)
        self.stop = threading.Event()
        self.interrupted = False
        self.dropped = 0
        self.failure: BaseException | None = None

    def run(self) -> None:
        """Take pictures until the source ends or ``stop`` is set."""
        try:
            for picture in self._source.pictures(self.stop):
                if self.stop.is_set():
                    return
                try:
                    self._queue.put_nowait(picture)
                except Full:
                    self.dropped += 1
        except BaseException as error:
            self.failure = error

    def next(self, patience: float = 0.0) -> Picture | None:
        """Return the next picture, None if none comes within so many seconds."""
        with contextlib.suppress(Empty):
            return self._queue.get(timeout=patience) if patience else self._queue.get_nowait()
        return None


@contextlib.contextmanager
def _interrupting(taker: _Taker) -> Iterator[None]:
    """Let the first Ctrl-C end the recording; a second one ends the program as ever."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT) or signal.default_int_handler

    def end(*_: Any) -> None:
        taker.interrupted = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _write(folder: Path, picture: Picture, lossless: bool) -> None:
    """Write a picture whole or not at all, without waiting for the disk as ``atomic_path`` would."""
    stamp, image = picture
    suffix, options = (
        (".png", [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])
        if lossless
        else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    )
    _, data = cv2.imencode(suffix, image[..., ::-1], options)
    path = folder / f"{stamp}{suffix}"
    temporary = folder / f".{stamp}{suffix}"
    with writing(path):
        temporary.write_bytes(data.tobytes())
        os.replace(temporary, path)
