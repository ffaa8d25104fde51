"""The indoor world: a furnished room, walked around by somebody with a camera in the hand."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from prgbd.plugins.data.synthetic import camera_path as motion
from prgbd.plugins.data.synthetic import painting, things
from prgbd.plugins.data.synthetic.scene import SceneBuilder
from prgbd.plugins.data.synthetic.textures import TextureAtlas
from prgbd.plugins.data.synthetic.world import Mover, Stage, World, lit

CEILING = 2.6
FURNITURE = 0.6  # depth of what stands along the walls, metres
AISLE = 1.15  # from the walls to the camera's path, metres
POSTERS, SHELVES, WOODS, CLOTHS = 12, 4, 4, 3


def build_room(seed: int, frames: int, movers: int, reverse: bool) -> World:
    """Build the room of a seed.

    Args:
        seed: Decides the layout, textures and colours.
        frames: Number of camera poses.
        movers: Number of people walking about.
        reverse: Walk around the other way.
    """
    stage = _stage(seed)
    poses = _walk(np.random.default_rng([seed, 13]), _path(stage.half, stage.clockwise != reverse), frames)
    return World(stage, poses, _people(np.random.default_rng([seed, 14]), stage.atlas, stage.half, movers))


@lru_cache(maxsize=2)
def _stage(seed: int) -> Stage:
    rng = np.random.default_rng([seed, 11])
    atlas = _textures(np.random.default_rng([seed, 12]))
    half = np.array([rng.uniform(2.7, 3.4), rng.uniform(2.5, 3.0)])
    builder = SceneBuilder(atlas)
    _shell(rng, builder, half)
    for wall in range(4):
        _wall(rng, builder, half, wall)
    _table(rng, builder)
    light = np.array([rng.uniform(-0.5, 0.5), -1.0, rng.uniform(-0.5, 0.5)])
    light = np.append(light / np.linalg.norm(light), rng.uniform(0.72, 0.8))
    sky = np.array([30.0, 30, 30, 30, 30, 30, 0])
    return Stage(lit(builder.finish(), light), atlas, light, sky, half, bool(rng.random() < 0.5))


def _textures(rng: Generator) -> TextureAtlas:
    atlas = TextureAtlas()
    atlas.add("floor", painting.planks(rng, 512, 10) if rng.random() < 0.6 else painting.paving(rng, 512, 6, 6))
    atlas.add("ceiling", painting.paving(rng, 256, 4, 4))
    for i in range(4):
        plain = painting.rough(rng, 512, painting.colour(rng, 130, 200, 0.2), 12, 4)
        atlas.add(f"wall{i}", painting.bricks(rng, 512, 24) if rng.random() < 0.3 else plain)
    for i in range(POSTERS):
        atlas.add(f"poster{i}", painting.poster(rng, 256))
    for i in range(SHELVES):
        atlas.add(f"books{i}", painting.books(rng, 512, int(rng.integers(4, 7))))
    for i in range(WOODS):
        atlas.add(f"wood{i}", painting.planks(rng, 256, int(rng.integers(2, 6))))
    for i in range(CLOTHS):
        atlas.add(f"cloth{i}", painting.pattern(rng, 256))
    atlas.add("view", painting.facade(rng, 512))
    atlas.add("leaves", painting.rough(rng, 256, rng.uniform([50, 80, 30], [90, 120, 55]), 40, 16))
    atlas.add("bark", painting.rough(rng, 128, [110, 100, 90], 26, 8))
    atlas.add("paint", painting.rough(rng, 64, [222, 222, 222], 8, 4))
    return atlas


def _shell(rng: Generator, builder: SceneBuilder, half: NDArray[np.float64]) -> None:
    """Floor, rug, ceiling with lamps, and four walls with skirting boards."""
    x, z = half
    things.level(builder, -x, x, -z, z, 0.0, "floor", metres=2.4, variation=0.25)
    rug = rng.uniform(0.9, 1.4, 2)
    things.level(builder, -rug[0], rug[0], -rug[1], rug[1], 0.01, f"cloth{rng.integers(CLOTHS)}")
    builder.quad((-x, -CEILING, -z), (0, 0, 2 * z), (2 * x, 0, 0), "ceiling", metres=2.4)
    # In this order the walls, length times height, are seen from inside.
    corners = np.array([[-x, z], [-x, -z], [x, -z], [x, z]])
    for wall in range(4):
        a, b = corners[wall], corners[(wall + 1) % 4]
        along = np.array([b[0] - a[0], 0.0, b[1] - a[1]])
        start = np.array([a[0], -CEILING, a[1]])
        builder.quad(start, along, (0, CEILING, 0), f"wall{wall}", metres=2.5, variation=0.2)
        inwards = 0.015 * np.cross(along, [0, 1, 0]) / np.linalg.norm(along)
        board = start + inwards + [0, CEILING - 0.12, 0]
        builder.quad(board, along, (0, 0.12, 0), f"wood{wall % WOODS}", metres=0.8)
    for i in (-1, 1):
        lamp = np.array([i * rng.uniform(0.4, 0.6) * x, -CEILING + 0.12, rng.uniform(-0.4, 0.4) * z])
        reach = np.array([0.3, 0.06, 0.15])
        builder.box(lamp - reach, lamp + reach, "paint", faces="xXzZyY", metres=0.5, tint=(1.1, 1.1, 1.05))


class _Wall:
    """Places things along one wall: ``a`` metres along it from its middle, ``c`` metres off it into the room."""

    def __init__(self, builder: SceneBuilder, half: NDArray[np.float64], wall: int) -> None:
        self.builder, self.along_x = builder, wall % 2 == 0
        self.sign = 1.0 if wall in (0, 1) else -1.0
        self.reach, self.edge = (half[0], half[1]) if self.along_x else (half[1], half[0])

    def point(self, a: float, c: float, height: float) -> NDArray[np.float64]:
        """Return the world point."""
        across = self.sign * (self.edge - c)
        return np.array([a, -height, across] if self.along_x else [across, -height, a])

    def box(
        self,
        a: tuple[float, float],
        c: tuple[float, float],
        heights: tuple[float, float],
        textures: str | dict[str, str],
        front: str | None = None,
        **look: object,
    ) -> None:
        """Add a box; ``front`` is the texture of the side that faces the room."""
        ends = np.stack([self.point(a[0], c[0], heights[0]), self.point(a[1], c[1], heights[1])])
        skins = dict(textures) if isinstance(textures, dict) else {"side": textures}
        low, high = ends.min(axis=0), ends.max(axis=0)
        face = ("z" if self.sign > 0 else "Z") if self.along_x else ("x" if self.sign > 0 else "X")
        if front is None:
            self.builder.box(low, high, skins, faces="xXzZy", **look)  # type: ignore[arg-type]
            return
        self.builder.box(low, high, front, faces=face)
        self.builder.box(low, high, skins, faces="xXzZy".replace(face, ""), **look)  # type: ignore[arg-type]


def _wall(rng: Generator, builder: SceneBuilder, half: NDArray[np.float64], number: int) -> None:
    """Furnish one wall from end to end; above low furniture hang pictures."""
    wall = _Wall(builder, half, number)
    # The corners stay free so that the furniture of two walls does not meet.
    place, end = -wall.reach + FURNITURE + 0.05, wall.reach - FURNITURE - 0.05
    kinds = list(rng.permutation(["shelf", "cabinet", "sofa", "desk", "window", "boxes", "plant", "shelf"]))
    while end - place > 0.8:
        kind = kinds.pop() if kinds else "boxes"
        width = min(rng.uniform(0.8, 1.5), end - place)
        height = _piece(rng, wall, kind, place, place + width)
        if height < 1.4:
            _pictures(rng, wall, place, place + width, height + 0.15)
        place += width + rng.uniform(0.02, 0.2)
    for a in (-wall.reach + 0.1, wall.reach - FURNITURE):
        _pictures(rng, wall, a, a + FURNITURE - 0.1, 1.0)


def _piece(rng: Generator, wall: _Wall, kind: str, a0: float, a1: float) -> float:
    """Add one piece of furniture between a0 and a1; return its height in metres."""
    wood, depth = f"wood{rng.integers(WOODS)}", rng.uniform(0.35, FURNITURE)
    tint = rng.uniform(0.7, 1.2, 3)
    if kind == "shelf":
        height = rng.uniform(1.5, 2.2)
        wall.box((a0, a1), (0, depth), (0, height), wood, f"books{rng.integers(SHELVES)}", metres=0.9, tint=tint)
        _clutter(rng, wall, (a0, a1), (0.05, depth), height)
        return CEILING
    if kind == "window":
        wall.box((a0, a1), (0, 0.06), (0.9, 2.2), "paint", "view", metres=1)
        wall.box((a0 + 0.1, a1 - 0.1), (0, 0.15), (0.2, 0.75), "paint", f"wood{rng.integers(WOODS)}", metres=0.5)
        return CEILING
    if kind == "sofa":
        cloth = f"cloth{rng.integers(CLOTHS)}"
        wall.box((a0, a1), (0, FURNITURE), (0, 0.42), cloth, metres=0.9, tint=tint)
        wall.box((a0, a1), (0, 0.2), (0.42, 0.85), cloth, metres=0.9, tint=tint)
        for a in (a0, a1 - 0.15):
            wall.box((a, a + 0.15), (0, FURNITURE), (0.42, 0.62), cloth, metres=0.9, tint=0.8 * tint)
        cushion = wall.point(rng.uniform(a0 + 0.25, a1 - 0.25), 0.3, 0.57)
        wall.builder.ball(cushion, (0.18, 0.15, 0.18), f"cloth{rng.integers(CLOTHS)}", metres=0.5)
        return 0.85
    if kind == "desk":
        wall.box((a0, a1), (0, depth), (0.70, 0.74), wood, metres=0.9)
        for a in (a0, a1 - 0.05):
            wall.box((a, a + 0.05), (0, depth), (0, 0.70), wood, metres=0.9)
        _clutter(rng, wall, (a0, a1), (0.05, depth), 0.74)
        screen = rng.uniform(a0 + 0.1, a1 - 0.6)
        wall.box((screen, screen + 0.5), (0.08, 0.12), (0.85, 1.18), "bark", f"poster{rng.integers(POSTERS)}", metres=1)
        return 1.2
    if kind == "plant":
        middle = wall.point((a0 + a1) / 2, 0.3, 0.0)
        wall.builder.post(middle, 0.4, 0.16, f"cloth{rng.integers(CLOTHS)}", sides=8)
        for _ in range(5):
            aside, up, across = rng.uniform(-0.12, 0.12), rng.uniform(0.05, 0.6), rng.uniform(-0.12, 0.12)
            centre = middle + np.array([aside, -0.5 - up, across])
            wall.builder.ball(centre, rng.uniform(0.1, 0.19, 3), "leaves", metres=0.5)
        return 1.35
    if kind == "cabinet":
        height = rng.uniform(0.7, 1.1)
        wall.box((a0, a1), (0, depth), (0, height), wood, f"wood{rng.integers(WOODS)}", metres=0.9, tint=tint)
        _clutter(rng, wall, (a0, a1), (0.05, depth), height)
        return height + 0.3
    height = 0.0
    for _ in range(int(rng.integers(1, 4))):
        a, size = rng.uniform(a0, a1 - 0.4), rng.uniform(0.25, 0.4)
        top = height + rng.uniform(0.2, 0.35)
        poster = f"poster{rng.integers(POSTERS)}"
        wall.box((a, a + size), (0.02, 0.02 + size), (height, top), poster, tint=rng.uniform(0.7, 1.1, 3))
        height = top
    return height


def _clutter(
    rng: Generator, wall: _Wall, a: tuple[float, float], c: tuple[float, float], height: float, count: int = 5
) -> None:
    """Scatter small boxes and balls over a surface; each has its own stretch, so that none meets another."""
    stretch = (a[1] - a[0]) / count
    for i in range(count):
        size, tall = rng.uniform(0.05, min(0.09, 0.45 * stretch), 2), rng.uniform(0.08, 0.28)
        middle = a[0] + (i + 0.5) * stretch
        across = rng.uniform(c[0] + 0.1, max(c[0] + 0.11, c[1] - 0.1))
        kind = rng.integers(0, 4)
        if kind == 0:
            radius = float(size[0])
            centre = wall.point(middle, across, height + radius)
            wall.builder.ball(centre, (radius,) * 3, f"poster{rng.integers(POSTERS)}", metres=0.25)
        elif kind == 1:
            poster = f"poster{rng.integers(POSTERS)}"
            wall.builder.post(wall.point(middle, across, height), tall, float(size[0]) * 0.7, poster, sides=8)
        else:
            spans = (middle - size[0], middle + size[0]), (across - size[1], across + size[1])
            wall.box(*spans, (height, height + tall), f"poster{rng.integers(POSTERS)}")


def _pictures(rng: Generator, wall: _Wall, a0: float, a1: float, lowest: float) -> None:
    """Hang one or two pictures over a stretch of wall."""
    number = int(rng.integers(1, 3))
    for i in range(number):
        middle = a0 + (i + 0.5) * (a1 - a0) / number
        half = rng.uniform(0.3, 0.45) * (a1 - a0) / number
        bottom = min(lowest + rng.uniform(0.05, 0.3), 2.0)
        top = min(bottom + 2 * half * rng.uniform(0.7, 1.4), 2.4)
        poster = f"poster{rng.integers(POSTERS)}"
        wall.box((middle - half, middle + half), (0, rng.uniform(0.01, 0.04)), (bottom, top), "bark", poster, metres=1)


def _table(rng: Generator, builder: SceneBuilder) -> None:
    """The table in the middle with clutter, and stools partly under it."""
    half, height = np.array([rng.uniform(0.5, 0.7), rng.uniform(0.32, 0.45)]), rng.uniform(0.68, 0.76)
    wood = f"wood{rng.integers(WOODS)}"
    builder.box((-half[0], -height, -half[1]), (half[0], -height + 0.04, half[1]), wood, faces="xXzZyY", metres=0.8)
    for x in (-half[0] + 0.05, half[0] - 0.05):
        for z in (-half[1] + 0.05, half[1] - 0.05):
            builder.box((x - 0.03, -height, z - 0.03), (x + 0.03, 0.0, z + 0.03), wood, metres=0.8)
    # A wall through the middle of the table serves to place things on it.
    middle = _Wall(builder, np.array([half[0], 0.0]), 0)
    for row in (-0.5, 0.5):
        across = row * half[1]
        _clutter(rng, middle, (-half[0] + 0.05, half[0] - 0.05), (across - 0.12, across + 0.1), height, 5)
    for side in (-1, 1):
        x = side * rng.uniform(0.2, 0.4)
        z = side * (half[1] + 0.02)
        cloth = f"cloth{rng.integers(CLOTHS)}"
        builder.box((x - 0.17, -0.45, z - 0.17), (x + 0.17, -0.40, z + 0.17), cloth, faces="xXzZyY")
        builder.post((x, 0.0, z), 0.40, 0.06, wood)


def _path(half: NDArray[np.float64], clockwise: bool) -> motion.ClosedPath:
    angles = np.linspace(0, 2 * np.pi, 120, endpoint=False) * (-1 if clockwise else 1)
    corners = np.stack([(half[0] - AISLE) * np.cos(angles), (half[1] - AISLE) * np.sin(angles)], axis=1)
    return motion.closed_path(corners, 0.05, 0.02)


def _walk(rng: Generator, path: motion.ClosedPath, frames: int) -> NDArray[np.float64]:
    """Return the poses (frames, 4, 4) of a camera in the hand of somebody who walks around, looking across."""
    start = rng.uniform(0, path.length)
    shifted = motion.ClosedPath(np.roll(path.points, -int(start / path.step), axis=0), path.step)
    moved = motion.travelled(shifted, frames, 0.045, 0.03, 0.03)
    steps = np.arange(frames, dtype=np.float64)
    ground = shifted.at(moved, 0.08 * motion.sway(rng, steps, 40.0))
    height = 1.42 + 0.06 * motion.sway(rng, steps, 35.0)
    position = np.stack([ground[:, 0], -height, ground[:, 1]], axis=1)
    target = 0.35 * np.stack([motion.sway(rng, steps, 90.0), motion.sway(rng, steps, 90.0)], axis=1)
    yaw = np.unwrap(np.arctan2(target[:, 0] - ground[:, 0], target[:, 1] - ground[:, 1]))
    yaw += 0.16 * motion.sway(rng, steps, 60.0)
    pitch = -0.16 + 0.08 * motion.sway(rng, steps, 45.0)
    return motion.poses_looking(position, yaw, pitch, 0.05 * motion.sway(rng, steps, 40.0))


def _people(rng: Generator, atlas: TextureAtlas, half: NDArray[np.float64], count: int) -> list[Mover]:
    """Return people who step to and fro before the walls, beyond the camera's path."""
    movers = []
    for i in range(count):
        number = int(rng.integers(4))
        reach = (half[0] if number % 2 == 0 else half[1]) - AISLE
        movers.append(Mover(things.walker(rng, atlas), _stroll(half, number, reach, i, rng.uniform(0, 2 * np.pi))))
    return movers


def _stroll(
    half: NDArray[np.float64], number: int, reach: float, which: int, phase: float
) -> Callable[[int], NDArray[np.float64]]:
    sign = 1.0 if number in (0, 1) else -1.0
    across = sign * ((half[1] if number % 2 == 0 else half[0]) - FURNITURE - 0.25)

    def pose(frame: int) -> NDArray[np.float64]:
        along = reach * np.sin(frame / (45.0 + 5 * which) + phase)
        out = np.eye(4)
        out[:3, 3] = [along, 0.0, across] if number % 2 == 0 else [across, 0.0, along]
        return out

    return pose
