"""What loop closing and relocalisation ask of a keyframe database."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class KeyframeLookup(Protocol):
    """Finds keyframes by appearance; ``loop_closing.keyframe_database`` holds the real one."""

    def query(
        self, descriptors: NDArray[np.uint64], *, exclude: Iterable[int] = ..., count: int | None = ...
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return keyframes that look like an image, at most ``count``, best first, and their scores."""
        ...
