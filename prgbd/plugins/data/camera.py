"""A live camera, a stream, or a file played as one: recorded first, then read as any recording."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from prgbd.core.errors import DataError
from prgbd.core.option_ranges import Count, Positive
from prgbd.io.naming import safe_name
from prgbd.io.reading import visible
from prgbd.plugins.data._camera import known_or_estimated
from prgbd.plugins.data._images import SUFFIXES, read_image
from prgbd.plugins.data._live_recording import read_note, record
from prgbd.plugins.data._live_source import LiveSource
from prgbd.plugins.data._recording import Files, FileSequence, frame_range

log = logging.getLogger("prgbd")


class CameraSequence(FileSequence):
    """What a camera shows from now on until Ctrl-C, the end of the stream, or a limit.

    The pictures are taken when this is made, at the rate at which they come, and kept in a folder; only then are they
    a recording with a length, whose frames can be read again and again. If the folder holds pictures already, they
    are the recording and no camera is opened: so further loops, ``resume`` and other runs see the same.

    Args:
        root: The number of a camera (0 is ``/dev/video0``) or its device, the address of a stream (``rtsp://...``), or
            a video file, which is played at its own rate as a rehearsal.
        folder: Where the pictures are kept, named by their times in nanoseconds.
        sequence: None; a camera has no names of recordings.
        frames: How many pictures to keep at most; None for no limit.
        seconds: How long to record at most; None for no limit.
        lossless: Keep PNG, which takes more time and room, rather than JPEG.
        options: FFmpeg's options for the camera or stream, such as ``{"video_size": "1280x720", "framerate": 30}``.
        camera: A YAML file (``camera: {width, height, fx, fy, cx, cy, distortion}`` or ``fov_degrees``) or its content;
            None takes ``camera.yaml`` in ``folder``; where there is none, COLMAP estimates it (extra ``colmap``).
        fov: Horizontal field of view in degrees, instead of ``camera``.
        start: First frame.
        stop: Frame to stop before; None for the end.
        step: Take every ``step``-th frame.

    Raises:
        ConfigError: If an option has a value that cannot work.
        DataError: If the camera cannot be opened or gives nothing, or the folder holds something else.
        DiskError: If the folder cannot be written to.
    """

    def __init__(
        self,
        root: str | int | Path,
        folder: str | Path,
        sequence: str | None = None,
        frames: Count | None = None,
        seconds: Positive | None = None,
        lossless: bool = False,
        options: Mapping[str, Any] | None = None,
        camera: str | Path | Mapping[str, Any] | None = None,
        fov: float | None = None,
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        if sequence is not None:
            raise DataError(f"There is no sequence '{sequence}' of a camera; leave data.sequences empty.")
        home = Path(folder).expanduser()
        if home.is_dir() and visible(home, SUFFIXES):
            log.warning("%s holds a recording already, which is read; to record anew choose another data.folder.", home)
        else:
            _record(LiveSource(root, options or {}), home, frames, seconds, lossless)
        images = visible(home, SUFFIXES)
        note = read_note(home)
        said = "a recording that broke off" if note is None else f"recorded from {note.source}, {note.losses}"
        self.remarks = (said,)
        span = frame_range(len(images), start, stop, step, home.name)
        pinhole = known_or_estimated(
            camera, fov, home / "camera.yaml", home, lambda i: read_image(images[span[i]]), len(span)
        )
        files = Files(images, np.array([_nanoseconds(path) for path in images]) / 1e9)
        super().__init__(safe_name(home.resolve().name), pinhole, files, start, stop, step)


def _record(source: LiveSource, folder: Path, frames: int | None, seconds: float | None, lossless: bool) -> None:
    """Record, and say before and after what happens.

    Raises:
        DataError: If no picture came.
    """
    log.warning("Recording %s into %s; Ctrl-C ends the recording, and the run goes on with it.", source.name, folder)
    found = record(source, folder, frames, seconds, lossless)
    if not found.frames:
        raise DataError(
            f"No picture came from {source.name} (it ended {found.ended}); check data.root and data.options."
        )
    log.warning(
        "Recorded %d frames in %.1f s (%s); it ended %s.", found.frames, found.seconds, found.losses, found.ended
    )
    if found.dropped:
        log.warning(
            "Writing was too slow for %d of %d pictures: lower the camera's size or rate (data.options), or use a "
            "faster disk.",
            *(found.dropped, found.dropped + found.frames),
        )


def _nanoseconds(path: Path) -> int:
    """Return the time that a picture is named by.

    Raises:
        DataError: If its name is none.
    """
    if not (path.stem.isascii() and path.stem.isdigit()) or len(path.stem) > 19:
        raise DataError(
            f"{path.parent} holds {path.name}, which is no picture of data=camera (their names are times in "
            "nanoseconds); choose another data.folder, or read it with data=images."
        )
    return int(path.stem)
