"""``example/wall``: a data set that needs no files, a camera that slides along a tilted, coloured wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd import Frame, PinholeCamera, Sequence
from prgbd.core.errors import ConfigError

NORMAL, DISTANCE = np.array([0.25, -0.15, 1.0]), 5.0  # the wall n x = d


class Wall(Sequence):
    """Images with true poses and depth.

    Args:
        sequence: Its name; there is one.
        frames: Number of frames.
        width: Pixels.
        height: Pixels.

    Raises:
        ConfigError: If there is no such sequence.
    """

    def __init__(self, sequence: str = "wall", frames: int = 16, width: int = 192, height: int = 128) -> None:
        if sequence != "wall":
            raise ConfigError(f"There is no sequence '{sequence}' of example/wall; choose 'wall'.")
        self.name = sequence
        self.camera = PinholeCamera.from_fov(width, height, 70.0)
        self.timestamps = np.arange(frames) / 10
        self._poses = np.tile(np.eye(4), (frames, 1, 1))
        self._poses[:, 0, 3] = 0.1 * np.arange(frames)
        v, u = np.mgrid[:height, :width].astype(float)
        self._rays = self.camera.backproject(np.stack([u.ravel(), v.ravel()], 1), np.ones(u.size))

    @property
    def poses(self) -> NDArray[np.float64]:
        """See ``Sequence.poses``."""
        return self._poses

    def depth(self, index: int) -> NDArray[np.float32]:
        """See ``Sequence.depth``."""
        return self._depth(index).reshape(self.camera.height, self.camera.width).astype(np.float32)

    def frame(self, index: int) -> Frame:
        """See ``Sequence.frame``."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        points = self._poses[index, :3, 3] + self._rays * self._depth(index)[:, None]
        cells = np.floor(8 * points[:, :2]).astype(np.int64) @ np.array([73856093, 19349663])
        image = np.stack([cells * prime % 251 for prime in (7, 31, 101)], 1).astype(np.uint8)
        shape = (self.camera.height, self.camera.width, 3)
        return Frame(index, float(self.timestamps[index]), image.reshape(shape), self.depth(index))

    def _depth(self, index: int) -> NDArray[np.float64]:
        distance = DISTANCE - NORMAL @ self._poses[index, :3, 3]
        return np.asarray(distance / (self._rays @ NORMAL))
