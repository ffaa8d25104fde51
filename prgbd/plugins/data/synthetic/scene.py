"""The static geometry of a synthetic world: textured parallelograms and ellipsoids, and the helper that builds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prgbd.plugins.data.synthetic.textures import TextureAtlas

UP = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True)
class Surfaces:
    """Surfaces as columns, in world coordinates (metres, y down).

    Attributes:
        quads: (N, 3, 3) float64: corner, first and second edge of a parallelogram; it is seen from the side
            that the cross product of its edges points to.
        quad_look: (N, 9) float64: texture, texels per metre along both edges, texture offset along both edges,
            red, green and blue factor, strength of the slow brightness variation.
        balls: (M, 2, 3) float64: centre and half axes of axis-aligned ellipsoids.
        ball_look: (M, 9) float64, as ``quad_look``.
    """

    quads: NDArray[np.float64]
    quad_look: NDArray[np.float64]
    balls: NDArray[np.float64]
    ball_look: NDArray[np.float64]

    def moved(self, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> Surfaces:
        """Return the surfaces after a rigid motion (ellipsoids keep their axes)."""
        quads = self.quads @ rotation.T
        quads[:, 0] += translation
        balls = self.balls.copy()
        balls[:, 0] = balls[:, 0] @ rotation.T + translation
        return Surfaces(quads, self.quad_look, balls, self.ball_look)

    @staticmethod
    def joined(parts: list[Surfaces]) -> Surfaces:
        """Return all parts as one."""
        return Surfaces(
            np.concatenate([p.quads for p in parts]),
            np.concatenate([p.quad_look for p in parts]),
            np.concatenate([p.balls for p in parts]),
            np.concatenate([p.ball_look for p in parts]),
        )


class SceneBuilder:
    """Collects surfaces.

    Args:
        atlas: The textures that names refer to.
    """

    def __init__(self, atlas: TextureAtlas) -> None:
        self.atlas = atlas
        self._quads: list[NDArray[np.float64]] = []
        self._quad_look: list[list[float]] = []
        self._balls: list[NDArray[np.float64]] = []
        self._ball_look: list[list[float]] = []

    def quad(
        self,
        corner: ArrayLike,
        first: ArrayLike,
        second: ArrayLike,
        texture: str,
        *,
        tint: ArrayLike = (1.0, 1.0, 1.0),
        metres: float | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
        variation: float = 0.15,
        mirrored: bool = False,
    ) -> None:
        """Add a parallelogram that is seen from the side that ``first x second`` points to.

        Args:
            corner: One corner, metres.
            first: Edge along the texture's columns, metres.
            second: Edge along the texture's rows (downwards), metres.
            texture: Name in the atlas.
            tint: Factor on red, green, blue.
            metres: Width of one tile of the texture; None stretches the texture over the whole surface.
            offset: Shift of the texture in tiles.
            variation: Strength of the slow brightness variation.
            mirrored: Mirror the texture along the first edge.
        """
        corner, first, second = (np.asarray(v, np.float64) for v in (corner, first, second))
        index, size = self.atlas.index(texture), self.atlas.size(texture)
        length = float(np.linalg.norm(first)), float(np.linalg.norm(second))
        scale = (size / length[0], size / length[1]) if metres is None else (size / metres, size / metres)
        start = [offset[0] * size, offset[1] * size]
        if mirrored:
            scale, start[0] = (-scale[0], scale[1]), start[0] + size
        self._quads.append(np.stack([corner, first, second]))
        self._quad_look.append([index, *scale, *start, *np.asarray(tint, np.float64), variation])

    def box(
        self,
        low: ArrayLike,
        high: ArrayLike,
        textures: dict[str, str] | str,
        *,
        tint: ArrayLike = (1.0, 1.0, 1.0),
        metres: float | None = None,
        variation: float = 0.15,
        faces: str = "xXzZy",
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Add an axis-aligned box; textures hang upright on its sides.

        Args:
            low: Least x, y, z.
            high: Greatest x, y, z.
            textures: One texture, or one per face with the key ``side`` for those not named.
            tint: Factor on red, green, blue.
            metres: As for ``quad``.
            variation: As for ``quad``.
            faces: Which faces to add: small letters are the least coordinate (``y`` is the top), capitals the greatest.
            offset: As for ``quad``.
        """
        (x0, y0, z0), (x1, y1, z1) = np.asarray(low, np.float64), np.asarray(high, np.float64)
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        # Corner and edges such that first x second points outwards; with y down, the second edge of sides is +y.
        sides = {
            "z": ((x1, y0, z0), (-dx, 0, 0), (0, dy, 0)),
            "Z": ((x0, y0, z1), (dx, 0, 0), (0, dy, 0)),
            "x": ((x0, y0, z0), (0, 0, dz), (0, dy, 0)),
            "X": ((x1, y0, z1), (0, 0, -dz), (0, dy, 0)),
            "y": ((x0, y0, z0), (dx, 0, 0), (0, 0, dz)),
            "Y": ((x0, y1, z1), (dx, 0, 0), (0, 0, -dz)),
        }
        for face in faces:
            texture = textures if isinstance(textures, str) else textures.get(face, textures.get("side", ""))
            corner, first, second = (np.asarray(v, np.float64) for v in sides[face])
            if np.dot(np.cross(first, second), _outward(face)) < 0:
                corner, first = corner + first, -first
            self.quad(corner, first, second, texture, tint=tint, metres=metres, variation=variation, offset=offset)

    def post(
        self, base: ArrayLike, height: float, radius: float, texture: str, *, sides: int = 6, **look: float
    ) -> None:
        """Add an upright prism that stands on ``base``."""
        base = np.asarray(base, np.float64)
        angles = 2 * np.pi * np.arange(sides + 1) / sides
        ring = base + radius * np.stack([np.cos(angles), np.zeros(sides + 1), np.sin(angles)], axis=1) + height * UP
        for i in range(sides):
            first, second = ring[i + 1] - ring[i], -height * UP
            corner = ring[i]
            outward = ring[i] + ring[i + 1] - 2 * (base + height * UP)
            if np.dot(np.cross(first, second), outward) < 0:
                corner, first = corner + first, -first
            self.quad(corner, first, second, texture, metres=1.0, **look)  # type: ignore[arg-type]
        # Prisms are open above; what a camera at eye level can look into gets a lid.
        if height < 1.5:
            self.ball(base + height * UP, (0.97 * radius, 0.01, 0.97 * radius), texture, metres=1.0)

    def ball(
        self, centre: ArrayLike, half_axes: ArrayLike, texture: str, *, tint: ArrayLike = (1.0, 1.0, 1.0), metres: float
    ) -> None:
        """Add an axis-aligned ellipsoid whose texture is laid around it and repeats every ``metres``."""
        scale = self.atlas.size(texture) / metres
        self._balls.append(np.stack([np.asarray(centre, np.float64), np.asarray(half_axes, np.float64)]))
        self._ball_look.append([self.atlas.index(texture), scale, scale, 0.0, 0.0, *np.asarray(tint, np.float64), 0.2])

    def finish(self) -> Surfaces:
        """Return what was added."""
        return Surfaces(
            np.array(self._quads).reshape(-1, 3, 3),
            np.array(self._quad_look).reshape(-1, 9),
            np.array(self._balls).reshape(-1, 2, 3),
            np.array(self._ball_look).reshape(-1, 9),
        )


def _outward(face: str) -> NDArray[np.float64]:
    normal = np.zeros(3)
    normal["xyz".index(face.lower())] = 1.0 if face.isupper() else -1.0
    return normal
