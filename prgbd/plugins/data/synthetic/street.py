"""The street world: a city block with its roads, house fronts, cars, trees and lamps, driven around by a car."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from prgbd.plugins.data.synthetic import camera_path as motion
from prgbd.plugins.data.synthetic import painting, things
from prgbd.plugins.data.synthetic.scene import SceneBuilder, Surfaces
from prgbd.plugins.data.synthetic.textures import TextureAtlas
from prgbd.plugins.data.synthetic.world import Mover, Stage, World, lit

ROAD = 5.0  # half the width of a road, metres
PAVEMENT = 3.5  # width of a pavement, metres
KERB = 0.12  # height of the pavement, metres
STUB = 45.0  # length of the roads beyond the crossings, metres
LANE = 1.6  # from the middle of the road to the middle of the lane, metres
CAMERA_HEIGHT = 1.65
FACADES, POSTERS, SIDES = 20, 8, 4


def build_street(seed: int, frames: int, movers: int, reverse: bool) -> World:
    """Build the street of a seed.

    Args:
        seed: Decides the layout, textures and colours.
        frames: Number of camera poses.
        movers: Number of moving cars and walkers.
        reverse: Drive around the block the other way.
    """
    stage = _stage(seed)
    corners = motion.rounded_rectangle(stage.half[0], stage.half[1], 12.0, stage.clockwise != reverse)
    path = motion.closed_path(corners, 3)
    distance, poses = _drive(np.random.default_rng([seed, 3]), path, frames)
    return World(stage, poses, _movers(np.random.default_rng([seed, 4]), stage.atlas, path, distance, movers))


# Several sequences of one seed (training, evaluation, another length) share the 130 MB of a street.
@lru_cache(maxsize=2)
def _stage(seed: int) -> Stage:
    rng = np.random.default_rng([seed, 1])
    atlas = _textures(np.random.default_rng([seed, 2]))
    half = np.array([rng.uniform(28, 42), rng.uniform(24, 36)])
    builder = SceneBuilder(atlas)
    _roads(rng, builder, half)
    cars = [things.car(rng, atlas) for _ in range(8)]
    parts = []
    for block in _blocks(half):
        parts += _block(rng, builder, block, cars)
    _ends(rng, builder, half)
    azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.6, 1.0)
    light = np.array([np.cos(azimuth), -height, np.sin(azimuth)])
    light = np.append(light / np.linalg.norm(light), rng.uniform(0.62, 0.75))
    sky = np.concatenate([rng.uniform([185, 195, 205], [225, 228, 235]), rng.uniform([95, 125, 165], [150, 175, 215])])
    clockwise = bool(rng.random() < 0.5)
    sky = np.append(sky, rng.uniform(7, 16))
    return Stage(lit(Surfaces.joined([builder.finish(), *parts]), light), atlas, light, sky, half, clockwise)


def _textures(rng: Generator) -> TextureAtlas:
    atlas = TextureAtlas()
    atlas.add("asphalt", painting.asphalt(rng, 1024))
    atlas.add("patch", painting.asphalt(rng, 256))
    atlas.add("paving", painting.paving(rng, 512, 12, 8))
    atlas.add("kerb", painting.paving(rng, 128, 1, 1))
    for i in range(FACADES):
        atlas.add(f"facade{i}", painting.facade(rng, 512))
    for i in range(SIDES):
        atlas.add(f"side{i}", painting.bricks(rng, 512, 32) if i % 2 else painting.rough(rng, 512, [150] * 3, 22, 4))
    for i in range(POSTERS):
        atlas.add(f"poster{i}", painting.poster(rng, 128))
    atlas.add("roof", painting.bricks(rng, 128, 16))
    atlas.add("leaves", painting.rough(rng, 256, rng.uniform([50, 80, 30], [90, 120, 55]), 34, 16))
    atlas.add("hedge", painting.rough(rng, 256, rng.uniform([40, 70, 30], [80, 110, 55]), 32, 16))
    atlas.add("grass", painting.rough(rng, 256, rng.uniform([80, 100, 45], [110, 130, 70]), 22, 8))
    atlas.add("bark", painting.rough(rng, 128, rng.uniform([70, 55, 40], [100, 85, 70]), 26, 8))
    atlas.add("metal", painting.rough(rng, 64, [120, 120, 122], 10, 8))
    atlas.add("paint", painting.rough(rng, 64, [222, 222, 222], 8, 4))
    atlas.add("marking", painting.rough(rng, 128, [205, 205, 200], 20, 8))
    atlas.add("shadow", painting.rough(rng, 64, [42, 42, 44], 6, 8))
    for i in range(2):
        atlas.add(f"car_side{i}", painting.car_side(rng, 256))
        atlas.add(f"car_end{i}", painting.car_end(rng, 128))
        atlas.add(f"car_glass{i}", painting.car_glass(rng, 128))
    return atlas


def _roads(rng: Generator, builder: SceneBuilder, half: NDArray[np.float64]) -> None:
    x, z = half
    far_x, far_z = x + STUB, z + STUB
    for side in (-1, 1):
        things.level(builder, -far_x, far_x, side * z - ROAD, side * z + ROAD, 0, "asphalt", metres=16, variation=0.25)
        for low, high in ((-far_z, -z - ROAD), (-z + ROAD, z - ROAD), (z + ROAD, far_z)):
            things.level(builder, side * x - ROAD, side * x + ROAD, low, high, 0, "asphalt", metres=16, variation=0.25)
    for along_x, reach, cross, line in ((True, far_x, x, z), (False, far_z, z, x)):
        for side in (-1, 1):
            for start in np.arange(-reach, reach, 5.0):
                if min(abs(start + 1 - cross), abs(start + 1 + cross)) > ROAD + 3:
                    _strip(builder, along_x, side * line, start, 2.2, 0.0, 0.14, "marking")
            for crossing in (-cross, cross):
                for stripe in np.arange(-ROAD + 0.6, ROAD, 1.1):
                    for where in (crossing - ROAD - 3, crossing + ROAD + 0.6):
                        _strip(builder, along_x, side * line, where, 2.4, stripe, 0.5, "marking")
            for _ in range(int(reach)):
                length, width = rng.uniform(0.4, 3.0), rng.uniform(0.3, 1.8)
                texture = rng.choice(["patch", "patch", "shadow", "paving", "kerb"])
                aside = rng.uniform(-ROAD + 1, ROAD - 1)
                height = rng.uniform(0.004, 0.008)
                _strip(builder, along_x, side * line, rng.uniform(-reach, reach), length, aside, width, texture, height)


def _strip(
    builder: SceneBuilder,
    along_x: bool,
    line: float,
    start: float,
    length: float,
    aside: float,
    width: float,
    texture: str,
    height: float = 0.01,
) -> None:
    """Add a mark on a road that runs along x (or z) at z (or x) = line."""
    span, across = (start, start + length), (line + aside - width / 2, line + aside + width / 2)
    x, z = (span, across) if along_x else (across, span)
    things.level(builder, *x, *z, height, texture, metres=2.0)


def _blocks(half: NDArray[np.float64]) -> list[tuple[float, float, float, float, str]]:
    """Return x0, x1, z0, z1 of the nine blocks and which of their sides (``x``, ``X``, ``z``, ``Z``) face a road."""
    x, z = half
    spans = [[(-v - STUB, -v - ROAD), (-v + ROAD, v - ROAD), (v + ROAD, v + STUB)] for v in (x, z)]
    facing = ("{0}", "{1}{0}", "{1}")
    return [
        (*spans[0][i], *spans[1][j], facing[i].format("X", "x") + facing[j].format("Z", "z"))
        for i in range(3)
        for j in range(3)
    ]


def _block(
    rng: Generator, builder: SceneBuilder, block: tuple[float, float, float, float, str], cars: list[Surfaces]
) -> list[Surfaces]:
    """Add the pavement of a block and what stands on and beside it; return its parked cars."""
    x0, x1, z0, z1, sides = block
    things.level(builder, x0, x1, z0, z1, KERB, "paving", metres=5, variation=0.2)
    builder.box((x0, -KERB, z0), (x1, 0.0, z1), "kerb", faces="xXzZ", metres=1.3)
    parked = []
    for side in sides:
        along_x = side in "zZ"
        low, high = (x0, x1) if along_x else (z0, z1)
        edge = {"x": x0, "X": x1, "z": z0, "Z": z1}[side]
        outwards = 1.0 if side.isupper() else -1.0
        _row_of_houses(rng, builder, along_x, low, high, edge, outwards)
        _furniture(rng, builder, along_x, low, high, edge, outwards)
        parked += _parked(rng, along_x, low, high, edge, outwards, cars)
    return parked


def _span(along_x: bool, a0: float, a1: float, c0: float, c1: float) -> tuple[float, float, float, float]:
    """Return x0, x1, z0, z1 for a span along a road and a span across it."""
    c0, c1 = min(c0, c1), max(c0, c1)
    return (a0, a1, c0, c1) if along_x else (c0, c1, a0, a1)


def _row_of_houses(
    rng: Generator, builder: SceneBuilder, along_x: bool, low: float, high: float, edge: float, outwards: float
) -> None:
    place, end = low + PAVEMENT, high - PAVEMENT
    while end - place > 4:
        width = min(rng.uniform(7, 15), end - place)
        if end - place - width < 6:
            width = end - place
        front = edge - outwards * (PAVEMENT + rng.choice([0.0, 0.0, 0.6, 1.5]))
        if width < 12 and rng.random() < 0.16:
            _garden(rng, builder, along_x, place, place + width, front, outwards)
        else:
            _house(rng, builder, along_x, place, place + width, front, outwards)
        place += width


def _house(
    rng: Generator, builder: SceneBuilder, along_x: bool, a0: float, a1: float, front: float, outwards: float
) -> None:
    height = rng.uniform(6, 15)
    x0, x1, z0, z1 = _span(along_x, a0, a1, front, front - outwards * 9)
    face = ("Z" if outwards > 0 else "z") if along_x else ("X" if outwards > 0 else "x")
    sides = "".join(f for f in "xXzZ" if f != face)
    tint = rng.uniform(0.75, 1.15) * rng.uniform(0.9, 1.1, 3)
    low, high = (x0, -height, z0), (x1, 0.0, z1)
    builder.box(low, high, f"facade{rng.integers(FACADES)}", faces=face, tint=tint, offset=(rng.choice([0, 0.5]), 0))
    builder.box(low, high, f"side{rng.integers(SIDES)}", faces=sides, tint=tint, metres=6)
    ledge = rng.uniform(0.2, 0.5)
    x0, x1, z0, z1 = _span(along_x, a0 + 0.05, a1 - 0.05, front + outwards * ledge, front)
    builder.box((x0, -height - 0.3, z0), (x1, -height, z1), "kerb", faces="xXzZY", tint=0.8 * tint, metres=2)
    for _ in range(int(rng.integers(0, 4))):
        a, width = rng.uniform(a0, a1 - 1.2), rng.uniform(0.5, 1.2)
        bottom = -rng.uniform(0.9, 1.6)
        x0, x1, z0, z1 = _span(along_x, a, a + width, front + outwards * rng.uniform(0.03, 0.12), front)
        texture = f"poster{rng.integers(POSTERS)}"
        builder.box((x0, bottom - 1.2 * width, z0), (x1, bottom, z1), texture)
    if rng.random() < 0.35:
        a, bottom = rng.uniform(a0, a1 - 1.0), -rng.uniform(2.5, 3.4)
        x0, x1, z0, z1 = _span(along_x, a, a + 0.15, front + outwards * rng.uniform(0.7, 1.3), front)
        builder.box((x0, bottom - 0.9, z0), (x1, bottom, z1), f"poster{rng.integers(POSTERS)}")


def _garden(
    rng: Generator, builder: SceneBuilder, along_x: bool, a0: float, a1: float, front: float, outwards: float
) -> None:
    """A gap between houses: grass, a hedge in front, trees and a wall behind."""
    x0, x1, z0, z1 = _span(along_x, a0, a1, front, front - outwards * 9)
    things.level(builder, x0, x1, z0, z1, KERB + 0.02, "grass", metres=3)
    x0, x1, z0, z1 = _span(along_x, a0, a1, front, front - outwards * 0.7)
    builder.box((x0, -rng.uniform(0.8, 1.5), z0), (x1, 0.0, z1), "hedge", metres=2.5)
    x0, x1, z0, z1 = _span(along_x, a0, a1, front - outwards * 9, front - outwards * 10)
    builder.box((x0, -rng.uniform(3, 8), z0), (x1, 0.0, z1), f"side{rng.integers(SIDES)}", metres=5)
    for _ in range(2):
        a, c = rng.uniform(a0 + 1, a1 - 1), front - outwards * rng.uniform(2.5, 7)
        things.tree(rng, builder, np.array([a, -KERB, c]) if along_x else np.array([c, -KERB, a]), 1.3)


def _furniture(
    rng: Generator, builder: SceneBuilder, along_x: bool, low: float, high: float, edge: float, outwards: float
) -> None:
    """Lamps, trees, signs, bins and boxes along the kerb."""
    for place in np.arange(low + 2.5, high - 2, 5.5):
        a, c = place + rng.uniform(-1, 1), edge - outwards * rng.uniform(0.5, 0.8)
        base = np.array([a, -KERB, c]) if along_x else np.array([c, -KERB, a])
        kind = rng.choice(["tree", "tree", "lamp", "sign", "bin", "cabinet", "none"])
        if kind == "tree":
            things.tree(rng, builder, base)
        elif kind == "lamp":
            builder.post(base, 5.0, 0.08, "metal")
            head, reach = base - np.array([0, 5.1, 0]), np.array([0.3, 0.1, 0.3])
            builder.box(head - reach, head + reach, "paint", metres=1, faces="xXzZyY")
        elif kind == "sign":
            builder.post(base, 2.4, 0.05, "metal")
            reach = (np.array([0.03, 0.0, 0.4]) if along_x else np.array([0.4, 0.0, 0.03])) * rng.uniform(0.8, 1.3)
            texture = f"poster{rng.integers(POSTERS)}"
            builder.box(base - reach - [0, 3.1, 0], base + reach - [0, 2.3, 0], texture)
        elif kind == "bin":
            builder.post(base, 1.0, 0.28, "poster0", sides=8, variation=0.3)
        elif kind == "cabinet":
            size = np.array([rng.uniform(0.2, 0.35), 0.0, rng.uniform(0.2, 0.35)])
            texture = f"poster{rng.integers(POSTERS)}"
            builder.box(base - size - [0, rng.uniform(0.9, 1.4), 0], base + size, texture)


def _parked(
    rng: Generator, along_x: bool, low: float, high: float, edge: float, outwards: float, cars: list[Surfaces]
) -> list[Surfaces]:
    """Return cars parked along the kerb, away from the crossings, where turning cars pass."""
    found = []
    place = low + 11
    while place < high - 11:
        if rng.random() < 0.5:
            c = edge + outwards * rng.uniform(0.95, 1.1)
            heading = rng.choice([-1.0, 1.0])
            where = np.array([place, 0, c]) if along_x else np.array([c, 0, place])
            turn = things.turned(np.array([heading, 0.0]) if along_x else np.array([0.0, heading]))
            found.append(cars[rng.integers(len(cars))].moved(turn, where))
        place += rng.uniform(5.4, 8)
    return found


def _ends(rng: Generator, builder: SceneBuilder, half: NDArray[np.float64]) -> None:
    """Close the far ends of the roads with houses."""
    for along_x, line, reach in ((False, half[1], half[0] + STUB), (True, half[0], half[1] + STUB)):
        for side in (-1, 1):
            for end in (-1, 1):
                for a0 in (line * side - 11, line * side):
                    _house(rng, builder, along_x, a0, a0 + 11, end * reach, -float(end))


def _drive(rng: Generator, path: motion.ClosedPath, frames: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance travelled, (frames,), and the poses, (frames, 4, 4), of the camera on a car."""
    start = rng.uniform(0, path.length)
    moved = start + motion.travelled(
        motion.ClosedPath(np.roll(path.points, -int(start / path.step), axis=0), path.step), frames, 0.8, 0.42, 0.036
    )
    steps = np.arange(frames, dtype=np.float64)

    def aside(distance: NDArray[np.float64]) -> NDArray[np.float64]:
        # Drawn anew from the same state so that both sides of the difference below agree.
        return LANE + 0.22 * motion.sway(np.random.default_rng(17), distance, 40.0)

    ahead = path.at(moved + 0.5, aside(moved + 0.5)) - path.at(moved - 0.5, aside(moved - 0.5))
    ground = path.at(moved, aside(moved))
    position = np.stack([ground[:, 0], -CAMERA_HEIGHT + 0.015 * motion.sway(rng, steps, 9.0), ground[:, 1]], axis=1)
    yaw = np.unwrap(np.arctan2(ahead[:, 0], ahead[:, 1])) + 0.006 * motion.sway(rng, steps, 25.0)
    pitch, roll = 0.006 * motion.sway(rng, steps, 9.0), 0.006 * motion.sway(rng, steps, 14.0)
    return moved, motion.poses_looking(position, yaw, pitch, roll)


def _movers(
    rng: Generator, atlas: TextureAtlas, path: motion.ClosedPath, distance: NDArray[np.float64], count: int
) -> list[Mover]:
    """Return cars on the other lane, a car ahead, and walkers, in turn."""
    movers = []
    for i in range(count):
        kind = i % 3
        shape = things.walker(rng, atlas) if kind == 2 else things.car(rng, atlas)
        gap, pace = 22.0 + 14.0 * (i // 3) + rng.uniform(0, 6), rng.uniform(0.4, 0.8)
        if kind == 2:
            pace = rng.choice([-1, 1]) * rng.uniform(0.1, 0.16)
        movers.append(Mover(shape, _track(path, distance, kind, gap, float(pace))))
    return movers


def _track(
    path: motion.ClosedPath, distance: NDArray[np.float64], kind: int, gap: float, pace: float
) -> Callable[[int], NDArray[np.float64]]:
    """Return the motion of one mover: 0 oncoming, 1 ahead on the same lane, 2 on the pavement."""

    def pose(frame: int) -> NDArray[np.float64]:
        if kind == 0:  # oncoming
            place, aside, sign = distance[0] + 1.6 * gap - pace * frame, -LANE, -1.0
        elif kind == 1:  # ahead on the same lane, with a changing gap
            place, aside, sign = distance[frame] + gap - 8 + 3 * np.sin(frame / 23), LANE, 1.0
        else:  # on the pavement
            place, aside, sign = distance[0] + gap + pace * frame, ROAD + 1.7, float(np.sign(pace))
        where = np.array([place])
        ground, heading = path.at(where, aside)[0], sign * path.forward(where)[0]
        out = np.eye(4)
        out[:3, :3] = things.turned(heading)
        out[:3, 3] = [ground[0], -KERB if kind == 2 else 0.0, ground[1]]
        return out

    return pose
