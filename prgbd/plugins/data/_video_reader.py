"""Reads the frames of a video file by number, in any order, each identified by the packet that it was decoded from."""

from __future__ import annotations

import gc
import os
import weakref
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.plugins.data._video_index import (
    MOST_THREADS,
    NO_STAMP,
    VideoIndex,
    decode,
    make_index,
    open_video,
    packets_of,
)
from prgbd.plugins.data._video_picture import Pictures, matrix, stored_size

FORWARD = 24  # packets that are decoded and dropped rather than sought over
ARRIVE = 1000  # packets behind a seek within which a known key frame must come

_alive: weakref.WeakSet[Any] = weakref.WeakSet()
_left_behind: list[Any] = []


def _leave_behind() -> None:
    """Keep what decodes and converts in a forked process: its threads are not there, and freeing it waits for them."""
    _left_behind.extend(_alive)
    gc.freeze()  # what the collector would come to has such threads as well


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_behind)


class VideoReader:
    """Reads frames of a file by number. A copy in another process opens the file for itself.

    Args:
        path: The file.

    Attributes:
        index: Its frames.
        aspect: Width over height of the samples that are stored; pictures come out with square ones.
        size: (width, height) of the pictures.
        stored: The same with samples as they are stored.
        interlaced: Whether the file holds fields rather than frames; one of them is kept.

    Raises:
        DataError: If the file is absent, or no frame of it can be decoded.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.index = make_index(path)
        self._owner = 0
        self._pass: _Pass | None = None
        self._last: tuple[int, NDArray[np.uint8]] | None = None
        self._careful = False
        self._pictures: Pictures | None = None
        self._shape: tuple[Any, ...] = ()
        first = self._frame(0)
        image = self._picture(0, first)
        self.aspect = self._pictures.aspect if self._pictures else 1.0
        self.size = (image.shape[1], image.shape[0])
        self.stored = stored_size(*self.size, first, self.aspect)
        self.interlaced = bool(first.interlaced_frame)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pass": None, "_last": None, "_pictures": None}

    def __len__(self) -> int:
        return len(self.index.packets)

    def read(self, number: int) -> NDArray[np.uint8]:
        """Return frame ``number``, (H, W, 3) uint8 RGB.

        Raises:
            DataError: If it cannot be decoded, or is of another size than the first.
        """
        if self._last is None or self._last[0] != number:
            self._last = (number, self._picture(number, self._frame(number)))
        return self._last[1].copy()

    def can_decode(self, number: int) -> bool:
        """Tell whether frame ``number`` can be decoded."""
        try:
            self._frame(number)
        except DataError:
            return False
        return True

    def decodable(self) -> int:
        """Return the number of frames up to the last one that can be decoded."""
        self._careful, self._pass = True, None
        end = len(self)
        while end > 0:
            begin = int(np.searchsorted(self.index.entries, self.index.entries[end - 1]))
            good = list(self._good(begin, end))
            if good:
                return good[-1] + 1
            end = begin
        return 0

    def cheap_start(self, number: int) -> int:
        """Return the last frame up to ``number`` that can be read without decoding others first."""
        return int(np.searchsorted(self.index.entries, self.index.entries[number]))

    def _good(self, begin: int, end: int) -> Iterator[int]:
        """Yield the undamaged frames of a range that has one key frame."""
        self._begin(int(self.index.entries[begin]))
        while self._pass is not None and (found := self._pass.next()) is not None and found[0] < end:
            number, _, damaged = found
            if number >= begin and not damaged:
                yield number

    def _picture(self, number: int, frame: Any) -> NDArray[np.uint8]:
        shape = (frame.width, frame.height, matrix(frame))
        if self._shape and shape != self._shape:
            raise DataError(f"Frame {number} of {self._path} has another size than the first; cut the video.")
        self._shape = shape
        try:
            if self._pictures is None:
                self._pictures = Pictures(self._open().aspect)
                _alive.add(self._pictures)
            return self._pictures.picture(frame)
        except (av.error.FFmpegError, ValueError) as error:
            raise DataError(f"The pixels of {self._path} cannot be converted; convert it, e.g. to MP4.") from error

    def _frame(self, number: int) -> Any:
        """Decode frame ``number``; where something is damaged, once more with one thread, which tells where."""
        if not 0 <= number < len(self):
            raise DataError(f"Frame {number} of {self._path} is not there; it has {len(self)} frames.")
        entry = int(self.index.entries[number])
        if not self._goes_on(number, entry):
            self._begin(entry)
        frame = self._found(number)
        if frame is None and not self._careful:
            self._careful, self._pass = True, None
            self._begin(entry)
            frame = self._found(number)
        if frame is None and entry > 0:  # pictures that are renewed bit by bit need more than one key frame
            at = int(np.searchsorted(self.index.keys, entry))
            self._begin(int(self.index.keys[max(0, at - 2)]))
            frame = self._found(number)
        if frame is None:
            self._pass = None
            raise DataError(self._damaged(number))
        return frame

    def _damaged(self, number: int) -> str:
        after = int(np.searchsorted(self.index.entries, self.index.entries[number], side="right"))
        mend = f"set data.stop to {number} or less"
        if after < len(self):
            mend += f", or data.start to {after} or more"
        return f"Frame {number} of {self._path} cannot be decoded; the file is damaged there: {mend}."

    def _open(self) -> _Pass:
        """The pass of decoding that is under way, or a new one at the beginning of the file."""
        if self._pass is not None and self._owner != os.getpid():
            self._pass = self._pictures = None
        if self._pass is None:
            self._pass, self._owner = _Pass(self._path, self.index, self._careful), os.getpid()
        return self._pass

    def _goes_on(self, number: int, entry: int) -> bool:
        """Tell whether decoding on reaches a frame about as fast as a key frame nearer to it."""
        going = self._open()
        return going.shown < number and going.begun and entry <= going.fed + FORWARD

    def _begin(self, entry: int) -> None:
        self._open().begin(entry)

    def _found(self, number: int) -> Any | None:
        """Decode on until frame ``number`` appears; None if it is damaged or never does."""
        going = self._open()
        while (found := going.next()) is not None:
            if found[0] == number:
                return None if found[2] else found[1]
            if found[0] > number:
                return None
        return None


class _Pass:
    """Decodes a file from a key frame on.

    Attributes:
        aspect: Width over height of the stored samples.
        begun: Whether ``begin`` was called.
        fed: The packet that the decoder gets next.
        shown: The frame that came out last, -1 before the first.
    """

    def __init__(self, path: Path, index: VideoIndex, careful: bool) -> None:
        self._path, self._index = path, index
        self._threads = 1 if careful else MOST_THREADS
        self._number = np.full(len(index.stamps) + 1, -1)
        self._number[index.packets] = np.arange(len(index.packets))
        self.begun = False
        self.fed = 0
        _alive.add(self)
        self._reopen()

    def begin(self, entry: int) -> None:
        """Bring the file to a key frame."""
        self.begun = True
        at = int(np.searchsorted(self._index.keys, entry))
        if self.fed != 0 or entry > FORWARD:
            for back in (0, 1, 4):
                if at > 0 and self._sought(int(self._index.keys[max(0, at - back)]), entry):
                    break
            else:
                self._reopen()
        self._skip_to(entry)
        self._bad = -1
        self._expected = int(np.searchsorted(self._index.entries, entry))
        self.shown = self._expected - 1

    def next(self) -> tuple[int, Any, bool] | None:
        """Return the number of the next frame of the index, the frame, and whether it is damaged; None at the end."""
        while True:
            while not self._out:
                if self._ended:
                    return None
                self._feed()
            frame = self._out.popleft()
            number = int(self._number[frame.pts]) if 0 <= frame.pts < len(self._number) else -1
            if number < self._expected:  # left out by an edit list, or shown before the key frame
                continue
            missing = self._index.packets[self._expected : number]
            suspects = [self._bad, *missing[missing < frame.pts]]
            self._bad = max([*suspects, frame.pts] if frame.is_corrupt else suspects)
            self._expected, self.shown = number + 1, number
            return number, frame, self._bad >= self._index.entries[number] and self._bad <= frame.pts

    def _feed(self) -> None:
        """Hand the next packet to the decoder and collect what comes out."""
        packet = next(self._packets, None)
        number = self.fed
        self._ended = packet is None
        try:
            if packet is not None:
                if not self._is(packet, number):  # the file does not repeat what it said: go no further
                    self._ended, packet = True, None
                else:
                    self.fed += 1
                    if packet.is_corrupt and self._tells:
                        self._bad = number
            self._out.extend(decode(self._stream.codec_context, packet, number))
        except av.error.FFmpegError:
            self._bad = number

    def _is(self, packet: Any, number: int) -> bool:
        """Tell whether a packet is the one that the index has under this number."""
        if number >= len(self._index.stamps):
            return False
        stamp = NO_STAMP if packet.pts is None else packet.pts
        return bool(self._index.stamps[number] == stamp and self._index.sizes[number] == packet.size)

    def _reopen(self) -> None:
        self._container, self._stream = open_video(self._path, self._threads)
        # A transport stream's counters jump where files were joined; where that hurts, the decoder says so itself.
        self._tells = self._container.format.name != "mpegts"
        self.aspect = float(self._stream.sample_aspect_ratio or 1)
        self._clear(0)

    def _clear(self, fed: int) -> None:
        self._packets = packets_of(self._container, self._stream)
        self._out: deque[Any] = deque()
        self._ended, self._bad, self._expected = False, -1, 0
        self.fed, self.shown = fed, -1

    def _sought(self, key: int, entry: int) -> bool:
        """Seek to a key frame; tell whether the file arrived at a known one no later than ``entry``."""
        stamp = self._index.stamps[key]
        if stamp == NO_STAMP:
            return False
        try:
            self._container.seek(int(stamp), stream=self._stream, backward=True)
        except (av.error.FFmpegError, OSError, OverflowError):
            return False
        self._clear(0)
        packets = self._packets
        for _ in range(ARRIVE):
            packet = next(packets, None)
            if packet is None:
                return False
            if packet.is_keyframe and packet.pts is not None:
                known = (self._index.stamps[self._index.keys] == packet.pts) & (
                    self._index.sizes[self._index.keys] == packet.size
                )
                at = self._index.keys[known]
                if len(at) != 1 or at[0] > entry:
                    return False
                self.fed = int(at[0])
                self._packets = _before(packet, packets)
                return True
        return False

    def _skip_to(self, entry: int) -> None:
        """Pass over packets without decoding them."""
        while self.fed < entry and next(self._packets, None) is not None:
            self.fed += 1


def _before(packet: Any, packets: Iterator[Any]) -> Iterator[Any]:
    yield packet
    yield from packets
