"""The interface of recordings: ``Sequence``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import Frame, PinholeCamera


class Sequence(ABC):
    """One recording of one camera, read frame by frame.

    A subclass sets ``name``, ``camera`` and ``timestamps`` in its constructor and implements ``frame``. Images come
    out undistorted and belong to ``camera``. Nothing but the asked-for frame is decoded, so memory does not grow
    with the length of the video. The constructor takes ``sequence`` (a name, or None for a data set that has one
    recording) besides its own options.

    Attributes:
        name: Short and safe as a file name (letters and digits of any script, ``-``, ``_``, ``.``); unique within the
            data set.
        camera: The camera of the images that ``frame`` returns.
        timestamps: (N,) float64 seconds, strictly ascending.
        baseline: Metres between left and right camera for stereo recordings, else None.
        depth_levels_per_metre: Grey levels in one metre of the recording's depth files where that is an option of the
            same name, else None; messages about a wrong scale say what it should be.
        concurrent: True if ``frame`` may be called by several threads at once, as where every frame is a file.
        remarks: What was understood of the recording where its files do not say it, in clauses that users are shown.
    """

    name: str
    camera: PinholeCamera
    timestamps: NDArray[np.float64]
    baseline: float | None = None
    depth_levels_per_metre: float | None = None
    concurrent: bool = False
    remarks: tuple[str, ...] = ()

    @classmethod
    def available(cls, **options: Any) -> list[str | None]:
        """Return the names that ``sequence=`` accepts for these options; ``[None]`` for a single recording.

        Raises:
            DataError: If the data set is not where the options say.
        """
        return [None]

    def __len__(self) -> int:
        return len(self.timestamps)

    def __iter__(self) -> Iterator[Frame]:
        """Yield every frame in order."""
        return (self.frame(index) for index in range(len(self)))

    @abstractmethod
    def frame(self, index: int) -> Frame:
        """Return frame ``index`` (0 <= index < len) with its image, and sensor depth or right image where recorded.

        Raises:
            DataError: If the image cannot be read; the message names the file.
            IndexError: If the index is out of range.
        """

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """True poses ``wTc``, (N, 4, 4) float64 with NaN where unknown, or None without ground truth."""
        return None

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """True depth of frame ``index``, (H, W) float32 metres with 0 where unknown, or None without ground truth."""
        return None

    @property
    def fps(self) -> float:
        """Frames per second, from the median time between frames."""
        return float(1.0 / np.median(np.diff(self.timestamps))) if len(self) > 1 else 30.0
