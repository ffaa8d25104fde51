"""What a synthetic world is made of, apart from the way it is built."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.data.synthetic.scene import Surfaces
from prgbd.plugins.data.synthetic.textures import TextureAtlas


@dataclass(frozen=True)
class Mover:
    """A rigid moving object.

    Attributes:
        shape: Its surfaces in its own coordinates (z forward, y down).
        motion: Returns its object-to-world pose (4, 4) at a frame.
    """

    shape: Surfaces
    motion: Callable[[int], NDArray[np.float64]]


@dataclass(frozen=True)
class Stage:
    """What of a world depends on the seed alone.

    Attributes:
        surfaces: What stands still.
        atlas: The textures, which moving objects use as well.
        light: (4,) direction to the light and the share of light that comes from everywhere.
        sky: (7,) colour at the horizon and overhead, contrast of the clouds.
        half: (2,) half the extent of the block or room along x and z, metres.
        clockwise: Which way round the path goes.
    """

    surfaces: Surfaces
    atlas: TextureAtlas
    light: NDArray[np.float64]
    sky: NDArray[np.float64]
    half: NDArray[np.float64]
    clockwise: bool


@dataclass(frozen=True)
class World:
    """A stage with a camera's motion and moving objects.

    Attributes:
        stage: What stands still.
        poses: (N, 4, 4) camera-to-world.
        movers: Moving objects.
    """

    stage: Stage
    poses: NDArray[np.float64]
    movers: list[Mover] = field(default_factory=list)


def lit(surfaces: Surfaces, light: NDArray[np.float64]) -> Surfaces:
    """Return the surfaces with the parallelograms' colours scaled by Lambert's law (ellipsoids are lit per pixel)."""
    normals = np.cross(surfaces.quads[:, 1], surfaces.quads[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    look = surfaces.quad_look.copy()
    look[:, 5:8] *= (light[3] + (1 - light[3]) * np.clip(normals @ light[:3], 0, None))[:, None]
    return Surfaces(surfaces.quads, look, surfaces.balls, surfaces.ball_look)
