"""Things that stand and move in synthetic worlds."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from prgbd.plugins.data.synthetic import painting
from prgbd.plugins.data.synthetic.scene import SceneBuilder, Surfaces
from prgbd.plugins.data.synthetic.textures import TextureAtlas


def level(
    builder: SceneBuilder, x0: float, x1: float, z0: float, z1: float, height: float, texture: str, **look: float
) -> None:
    """Add a level rectangle that is seen from above, ``height`` metres above the road."""
    # The y axis points down, so a surface seen from above has its normal along -y: that is -z times x.
    builder.quad((x0, -height, z1), (0, 0, z0 - z1), (x1 - x0, 0, 0), texture, **look)  # type: ignore[arg-type]


def tree(rng: Generator, builder: SceneBuilder, base: NDArray[np.float64], size: float = 1.0) -> None:
    """Add a tree: a trunk with a crown of a few balls."""
    height = size * rng.uniform(2.6, 3.6)
    builder.post(base, height, rng.uniform(0.1, 0.2), "bark")
    tint = rng.uniform(0.75, 1.25) * rng.uniform(0.9, 1.1, 3)
    for _ in range(int(rng.integers(2, 5))):
        aside, up, across = rng.uniform(-0.7, 0.7), rng.uniform(0, 1.2), rng.uniform(-0.7, 0.7)
        centre = base + np.array([size * aside, -height - size * up, size * across])
        builder.ball(centre, size * rng.uniform(0.8, 1.5, 3), "leaves", tint=tint, metres=2.2)


def car(rng: Generator, atlas: TextureAtlas) -> Surfaces:
    """Return a car around the origin, heading along +z."""
    builder = SceneBuilder(atlas)
    half, width, height = rng.uniform(1.9, 2.3), rng.uniform(0.8, 0.88), rng.uniform(0.8, 0.95)
    paint = painting.colour(rng, 50, 235, 0.5) / 225
    style = rng.integers(2)
    skin = {"x": f"car_side{style}", "X": f"car_side{style}", "side": f"car_end{style}", "y": "paint"}
    builder.box((-width, -height, -half), (width, -0.22, half), skin, tint=paint)
    cabin = height + rng.uniform(0.5, 0.65)
    front, back = rng.uniform(0.3, 0.7), -half + rng.uniform(0.1, 0.5)
    skin = {"side": f"car_glass{style}", "y": "paint"}
    builder.box((-width + 0.1, -cabin, back), (width - 0.1, -height, front), skin, tint=0.5 + 0.5 * paint)
    level(builder, -width - 0.1, width + 0.1, -half - 0.1, half + 0.1, 0.012, "shadow", metres=1)
    for x in (-width + 0.1, width - 0.1):
        for z in (-0.62 * half, 0.62 * half):
            builder.box((x - 0.1, -0.3, z - 0.3), (x + 0.1, 0.0, z + 0.3), "shadow", metres=1, faces="xXzZ")
    return builder.finish()


def turned(heading: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) that turns +z to the heading (x, z)."""
    x, z = heading
    return np.array([[z, 0, x], [0, 1, 0], [-x, 0, z]])


def walker(rng: Generator, atlas: TextureAtlas) -> Surfaces:
    """Return a person around the origin, upright."""
    builder = SceneBuilder(atlas)
    tint = painting.colour(rng, 60, 200, 0.6) / 150
    builder.ball((0, -1.6, 0), (0.11, 0.14, 0.12), "bark", tint=(2.2, 1.9, 1.7), metres=0.5)
    builder.ball((0, -1.15, 0), (0.24, 0.36, 0.18), "poster1", tint=tint, metres=0.8)
    builder.ball((-0.1, -0.42, 0), (0.1, 0.44, 0.11), "bark", tint=tint, metres=0.8)
    builder.ball((0.1, -0.42, 0), (0.1, 0.44, 0.11), "bark", tint=tint, metres=0.8)
    return builder.finish()
