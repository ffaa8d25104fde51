"""Which frames a video file has and when each is shown, read from its packets once without decoding them all."""

from __future__ import annotations

import itertools
import logging
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.stream import Disposition
from av.video.frame import PictureType
from numpy.typing import NDArray

from prgbd.core.errors import DataError
from prgbd.io.reading import require_file
from prgbd.plugins.data._images import SUFFIXES as IMAGE_SUFFIXES

log = logging.getLogger("prgbd")

NO_STAMP = np.iinfo(np.int64).min
PROBE = 12  # frames that are decoded to see whether the packets' time stamps tell the order of display
REORDERED = 64  # places by which a frame may be shown earlier or later than decoded; codecs allow 16
REPEATED_STAMPS = 0.1  # of the frames may share their time with another before no time stamp is believed
STILL = Disposition.attached_pic | Disposition.timed_thumbnails  # covers and previews
MOST_THREADS = 8  # each holds a decoded picture


@dataclass(frozen=True)
class VideoIndex:
    """The frames of a file in order of display, and the packets in the order of decoding.

    A packet's number is its place in the order of decoding. It is handed to the decoder in place of the time stamp
    and comes back with the frame, so that a frame's identity is certain whatever the file says of times.

    Attributes:
        packets: (N,) packet that holds each frame.
        entries: (N,) packet at which decoding must begin for each frame: the key frame before it.
        times: (N,) seconds ascending from 0.
        timed: False if ``times`` follow from the frame rate alone, for lack of time stamps.
        keys: (K,) packets at which decoding can begin.
        stamps: (P,) the packets' time stamps in the stream's unit, ``NO_STAMP`` where they have none.
        sizes: (P,) their bytes.
        rate: Frames per second by the header, 0 if it does not say.
    """

    packets: NDArray[np.int64]
    entries: NDArray[np.int64]
    times: NDArray[np.float64]
    timed: bool
    keys: NDArray[np.int64]
    stamps: NDArray[np.int64]
    sizes: NDArray[np.int64]
    rate: float


@dataclass(frozen=True)
class _Packets:
    """What the container says of its packets, each (P,) in order of decoding."""

    stamps: NDArray[np.int64]
    decoded_at: NDArray[np.int64]
    sizes: NDArray[np.int64]
    keys: NDArray[np.bool_]
    shown: NDArray[np.bool_]


def open_video(path: Path, threads: int = MOST_THREADS) -> tuple[Any, Any]:
    """Open a file and return its container and its video stream: the largest, first one that is no cover picture.

    Args:
        path: The file.
        threads: Threads to decode with. With one, errors are told of the very packet that causes them.

    Raises:
        DataError: If it is absent or no video.
    """
    require_file(path, "the video")
    try:
        # Metadata may be in any encoding, and a play list inside the file must not reach the network.
        container = av.open(str(path.absolute()), metadata_errors="replace", options={"protocol_whitelist": "file"})
        stream = max(_moving(container), key=lambda s: s.width * s.height, default=None)
        if stream is None:
            raise DataError(f"{path} holds no video that can be decoded; check the file, or convert it to MP4.")
        context = stream.codec_context
        context.thread_count = min(threads, (os.cpu_count() or 1) + 1)
        context.thread_type = "AUTO" if threads > 1 else "NONE"
    except (av.error.FFmpegError, OSError, ValueError, OverflowError) as error:
        raise DataError(_unreadable(path)) from error
    if container.format.name.endswith("_pipe") or container.format.name == "image2":
        raise DataError(_unreadable(path, image=True))
    return container, stream


def make_index(path: Path) -> VideoIndex:
    """Index a file.

    Raises:
        DataError: If it is absent, no video, or no frame of it can be decoded.
    """
    container, stream = open_video(path)
    with container:
        if len(_moving(container)) > 1:
            log.warning("%s holds several videos; the one of %dx%d is read.", path, stream.width, stream.height)
        packets = _listed(container, stream)
        rate = float(stream.average_rate or stream.guessed_rate or 0)
        base, claimed = float(stream.time_base or 0), stream.frames
        # Raw streams have no time stamps; FFmpeg makes some up at 25 Hz.
        made_up = bool(container.format.flags & av.format.Flags.no_timestamps.value)
    if not packets.shown.any():
        raise DataError(f"{path} has no frame that can be decoded; convert it, e.g. to MP4.")
    if claimed > len(packets.sizes):
        log.warning("%s says it has %d frames, but ends after %d.", path, claimed, len(packets.sizes))
    order, keys = _order(path, packets)
    entries = _entries(order, keys, packets.stamps)
    times = None if made_up else _times(packets, order, base)
    if times is None:
        timed, times = False, np.arange(len(order)) / (rate if rate > 0 else 1.0)
    else:
        timed, fresh = True, np.concatenate([[True], np.diff(times) > 0])
        if not fresh.all():
            count = int(np.count_nonzero(~fresh))
            log.warning("%d frame(s) of %s have the time stamp of another frame and are left out.", count, path)
        order, entries, times = order[fresh], entries[fresh], times[fresh]
    return VideoIndex(order, entries, times, timed, keys, packets.stamps, packets.sizes, rate)


def packets_of(container: Any, stream: Any) -> Iterator[Any]:
    """Yield the packets of a stream; a file that breaks off just ends."""
    with suppress(av.error.FFmpegError, OSError):
        for packet in container.demux(stream):
            if packet.size == 0 and packet.pts is None and packet.dts is None:
                return
            yield packet


def decode(context: Any, packet: Any, number: int) -> list[Any]:
    """Decode a packet, None for the end; the frames that come out carry their packets' numbers as ``pts``.

    Raises:
        av.error.FFmpegError: If it is damaged.
    """
    if packet is not None:
        if packet.size == 0:  # it would tell the decoder that all is over
            return []
        packet.pts = packet.dts = number
    return list(context.decode(packet))


def _moving(container: Any) -> list[Any]:
    """The video streams that are no cover pictures and whose codec is known."""
    return [s for s in container.streams.video if s.codec_context is not None and not s.disposition & STILL]


def _unreadable(path: Path, image: bool = False) -> str:
    if image or path.suffix.lower() in IMAGE_SUFFIXES:
        return f"{path} is a single image, no video; take data=images with the folder of the images as data.root."
    return f"{path} is no video that can be read, or is truncated; convert it, e.g. to MP4."


def _listed(container: Any, stream: Any) -> _Packets:
    rows = [
        (
            NO_STAMP if packet.pts is None else packet.pts,
            NO_STAMP if packet.dts is None else packet.dts,
            packet.size,
            packet.is_keyframe,
            # Edit lists leave packets out, which others refer to; an empty packet repeats the frame before.
            packet.size > 0 and not packet.is_discard,
        )
        for packet in packets_of(container, stream)
    ]
    table = np.array(rows, np.int64).reshape(-1, 5)
    return _Packets(table[:, 0], table[:, 1], table[:, 2], table[:, 3] > 0, table[:, 4] > 0)


def _order(path: Path, packets: _Packets) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the packets of the frames in order of display, and those where decoding can begin.

    The order of the time stamps is taken if the first frames come out of the decoder in it; else all are decoded.
    """
    keys = np.flatnonzero(packets.keys & (packets.sizes > 0))
    keys = keys if len(keys) else np.zeros(1, np.int64)
    shown = np.flatnonzero(packets.shown)
    order = shown[np.argsort(packets.stamps[shown], kind="stable")]
    stamped = (packets.stamps[shown] != NO_STAMP).all() and np.abs(order - shown).max() <= REORDERED
    first, whole, true_keys = _decoded(path, PROBE)
    if not first:
        raise DataError(f"{path} has no frame that can be decoded; convert it, e.g. to MP4.")
    flagged = np.intersect1d(keys, first)
    if len(np.setdiff1d(flagged, true_keys)):
        keys = keys[:1]  # the container calls frames key frames that are none
    begin = np.flatnonzero(order == first[0])
    if stamped and len(begin):
        expected = order[begin[0] : begin[0] + len(first)]
        if np.array_equal(expected, first) or not whole:
            if begin[0]:
                log.warning("The first %d frame(s) of %s cannot be decoded and are left out.", begin[0], path)
            return order[begin[0] :], keys
    log.warning("The time stamps of %s do not tell the order of its frames; it is decoded once to see.", path)
    found, whole, _ = _decoded(path, None)
    if not whole:
        log.warning("Some frames of %s cannot be decoded and are left out.", path)
    _, once = np.unique(found, return_index=True)
    return np.array(found, np.int64)[np.sort(once)], keys


def _decoded(path: Path, most: int | None) -> tuple[list[int], bool, list[int]]:
    """Decode from the beginning: the packets of the frames that come out, whether all is well, and the key frames."""
    container, stream = open_video(path)
    found: list[int] = []
    keys: list[int] = []
    whole = True
    with container:
        for number, packet in enumerate(itertools.chain(packets_of(container, stream), [None])):
            try:
                frames = decode(stream.codec_context, packet, number)
            except av.error.FFmpegError:
                whole, frames = False, []
            for frame in frames:
                whole &= not frame.is_corrupt
                found.append(frame.pts)
                if frame.key_frame or frame.pict_type == PictureType.I:
                    keys.append(frame.pts)
            if most is not None and len(found) >= most:
                break
    return found[:most], whole, keys


def _entries(order: NDArray[np.int64], keys: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the packet where decoding must begin for each frame: the last key frame decoded and shown no later.

    (A frame that is decoded after a key frame but shown before it may refer to what came before.)
    """
    shown_at = np.full(len(stamps), -1)
    shown_at[order] = np.arange(len(order))
    for key in keys[shown_at[keys] < 0]:  # left out by an edit list: it is shown before all with later time stamps
        shown_at[key] = np.searchsorted(stamps[order], stamps[key])
    at = np.maximum(np.searchsorted(keys, order, side="right") - 1, 0)
    while (late := (at > 0) & (shown_at[keys[at]] > np.arange(len(order)))).any():
        at[late] -= 1
    return keys[at]


def _times(packets: _Packets, order: NDArray[np.int64], base: float) -> NDArray[np.float64] | None:
    """Return the frames' times in seconds, or None if their time stamps make no sense."""
    for stamps in (packets.stamps[order], np.sort(packets.stamps[order]), np.sort(packets.decoded_at[order])):
        steps = np.diff(stamps)
        if (stamps != NO_STAMP).all() and (steps >= 0).all() and np.mean(steps == 0) <= REPEATED_STAMPS:
            return np.asarray((stamps - stamps[0]) * base, np.float64) if base > 0 else None
    return None
