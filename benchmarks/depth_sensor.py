r"""Is pseudo depth weighed rightly, whatever its errors? SLAM on a simulated sensor, beside SLAM that knows the errors.

A cell is a standard deviation and a correlation length of the scale error of a frame, and a standard deviation of the
own error of a pixel. In each, the default is compared with the better of mono and of systems that are told the cell's
true parameters, by the median ATE (RMSE after Sim3) over runs that differ in the number of features and in the drawn
errors. No option is set per cell or world.

Examples:
    python benchmarks/depth_sensor.py                                # thirteen cells, three worlds, one run each
    python benchmarks/depth_sensor.py --all --runs 5 --json cells.json
    python benchmarks/depth_sensor.py --only room
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from coupling import counts
from slam_measuring import Source, measure, warm_up
from tqdm import tqdm

import prgbd
from prgbd.core.data import Sequence
from prgbd.core.errors import DataError
from prgbd.core.slam import adaptive_baseline
from prgbd.core.types import Frame
from prgbd.evaluation.trajectory import absolute_error
from prgbd.plugins.depth.simulated import SimulatedDepth

LIMIT = 1.15
"""What the default may have of the error of the better of mono and the systems that know the cell."""
OWN_LENGTH = 10.0
"""Pixels: a network's errors are smooth over the image."""
SCALE_SIGMAS, SCALE_LENGTHS, OWN_SIGMAS = (0.0, 0.05, 0.15, 0.3), (1, 10, 100), (0.05, 0.2, 0.4)


@dataclass(frozen=True)
class Cell:
    """True parameters of a sensor: of the scale error (length in keyframes), and of a pixel's own error."""

    scale_sigma: float
    scale_length: float
    own_sigma: float

    @property
    def name(self) -> str:
        """Short, for ``--only`` and messages."""
        scale = f"s{self.scale_sigma:g}" + (f"/{self.scale_length:g}" if self.scale_sigma else "")
        return f"{scale}-e{self.own_sigma:g}"


@dataclass(frozen=True)
class World:
    """A synthetic world, its size, and about how many of its frames there are to a keyframe of ``orb_gtsam``."""

    name: str
    sequence: str
    frames: int
    width: int
    height: int
    frames_per_keyframe: float


WORLDS = (
    World("street", "street-1", frames=100, width=320, height=208, frames_per_keyframe=2.5),
    World("drift", "street-4", frames=240, width=320, height=160, frames_per_keyframe=2.0),
    World("room", "indoor-0", frames=150, width=256, height=192, frames_per_keyframe=5.0),
)


def cells(*, everything: bool) -> list[Cell]:
    """Return the cells: every scale error at the middle own error and three at other ones, or all that there are."""
    scales = [(0.0, 1), *((s, n) for s in SCALE_SIGMAS if s for n in SCALE_LENGTHS)]
    if everything:
        return [Cell(*scale, own) for own in OWN_SIGMAS for scale in scales]
    lowest, middle, highest = OWN_SIGMAS
    return [
        *(Cell(*scale, middle) for scale in scales),
        Cell(0.0, 1, lowest),
        Cell(0.15, 10, lowest),
        Cell(0.15, 10, highest),
    ]


def knowing(cell: Cell) -> dict[str, dict[str, Any]]:
    """Return SLAM's options by the names of the systems that know the true parameters of a cell."""
    return {
        "sensor weights": {"depth": {"follow": False, "shared": 1, "sigma": cell.own_sigma}},
    }


class Remembered(Sequence):
    """A recording in memory: its frames are drawn once, and used by all runs."""

    def __init__(self, sequence: Sequence) -> None:
        self.name, self.camera, self.timestamps = sequence.name, sequence.camera, sequence.timestamps
        self._frames, self._poses = list(sequence), sequence.poses
        self._depths = [sequence.depth(index) for index in range(len(sequence))]

    def frame(self, index: int) -> Frame:
        """See ``Sequence.frame``."""
        return self._frames[index]

    def depth(self, index: int):
        """See ``Sequence.depth``."""
        return self._depths[index]

    @property
    def poses(self):
        """See ``Sequence.poses``."""
        return self._poses


@dataclass
class Bench:
    """A world, and runs of SLAM in it that differ in the number of features and in the drawn errors."""

    world: World
    runs: int
    bar: tqdm

    @cached_property
    def sequence(self) -> Remembered:
        """The recording."""
        world = self.world
        size = {"frames": world.frames, "width": world.width, "height": world.height}
        return Remembered(prgbd.make_data("synthetic", sequence=world.sequence, **size))

    def sources(self, cell: Cell) -> list[Source]:
        """Return the frames with simulated depth, for every run."""
        sequence, made = self.sequence, []
        for seed in range(self.runs):
            sensor = SimulatedDepth(
                scale_sigma=cell.scale_sigma,
                scale_length=cell.scale_length * self.world.frames_per_keyframe,
                own_sigma=cell.own_sigma,
                own_length=OWN_LENGTH,
                seed=seed,
            )
            depths = [sensor.depth(sequence, index) for index in range(len(sequence))]
            baseline = adaptive_baseline(float(np.max(depths)))
            inverse = {index: 1.0 / depth for index, depth in enumerate(depths)}
            made.append(Source(sequence, "pseudo_rgbd", range(len(sequence)), baseline, inverse))
        return made

    def measured(self, sources: list[Source], options: dict[str, Any], label: str) -> dict[str, Any]:
        """Return the ATE of every run, its median (infinite without a trajectory), and the fewest frames tracked."""
        errors, tracked = [], []
        for source, count in zip(sources, counts(self.sequence, self.runs), strict=True):
            self.bar.set_description(f"{self.world.name}, {label}")
            result = measure(source, {**options, "features": {"count": count}}, seed=0, label=label).result
            errors.append(self._error(result))
            tracked.append(len(result.trajectory))
            self.bar.update()
        return {"ate": errors, "median": float(np.median(errors)), "tracked": min(tracked)}

    def _error(self, result: prgbd.SlamResult) -> float:
        try:
            return round(absolute_error(result.trajectory, np.asarray(self.sequence.poses)).rmse, 5)
        except DataError:  # next to nothing was tracked
            return math.inf

    @cached_property
    def mono(self) -> dict[str, Any]:
        """What mono makes of the world; it looks at no depth, so it is the same in every cell."""
        source = Source(self.sequence, "mono", range(len(self.sequence)))
        warm_up(source, {})
        return self.measured([source] * self.runs, {}, "mono")

    def row(self, cell: Cell) -> dict[str, Any]:
        """Compare the default with the better of mono and the systems that know the cell."""
        sources = self.sources(cell)
        found = {"mono": self.mono, "default": self.measured(sources, {}, f"{cell.name}, default")}
        for name, options in knowing(cell).items():
            found[name] = self.measured(sources, options, f"{cell.name}, {name}")
        best = min((name for name in found if name != "default"), key=lambda name: found[name]["median"])
        ratio = found["default"]["median"] / found[best]["median"]
        return {"world": self.world.name, "frames": len(self.sequence), "best": best, "ratio": ratio, "systems": found}


def rows(chosen: list[tuple[Cell, list[World]]], runs: int) -> Iterator[dict[str, Any]]:
    """Measure cells, one after the other, in all of their worlds."""
    worlds = list(dict.fromkeys(world for _, several in chosen for world in several))
    total = runs * (len(worlds) + sum((1 + len(knowing(cell))) * len(several) for cell, several in chosen))
    with tqdm(total=total, unit="run", disable=not sys.stderr.isatty()) as bar:
        benches = {world.name: Bench(world, runs, bar) for world in worlds}
        for cell, several in chosen:
            yield {"cell": asdict(cell), "worlds": [benches[world.name].row(cell) for world in several]}


def as_line(row: dict[str, Any], worlds: list[World]) -> str:
    """Return a row of the table; what is above the limit is bold."""
    cell, found = row["cell"], {one["world"]: one for one in row["worlds"]}
    length = f"{cell['scale_length']:g}" if cell["scale_sigma"] else "-"
    entries = [f"{cell['scale_sigma']:g}", length, f"{cell['own_sigma']:g}"]
    entries += [_entry(found[world.name]) if world.name in found else "" for world in worlds]
    return f"| {' | '.join(entries)} |"


def _entry(found: dict[str, Any]) -> str:
    """Return the errors of the systems, the default's first, and its ratio to the best of the others."""
    frames = found["frames"]
    errors = [
        f"{figures['median']:.3g}" + ("" if figures["tracked"] == frames else f" ({figures['tracked']}/{frames})")
        for name, figures in sorted(found["systems"].items(), key=lambda item: item[0] != "default")
    ]
    ratio = f"{found['ratio']:.2f}"
    return " / ".join(errors) + f": {f'**{ratio}**' if found['ratio'] > LIMIT else ratio}"


def verdict(found: list[dict[str, Any]]) -> str:
    """Say in how many cells and worlds the default is within the limit, and where it is farthest from it."""
    ratios = [(one["ratio"], one["world"], Cell(**row["cell"]).name) for row in found for one in row["worlds"]]
    within = sum(ratio <= LIMIT for ratio, _, _ in ratios)
    worst, world, cell = max(ratios)
    return f"{within} of {len(ratios)} within {LIMIT}; the worst is {worst:.2f} ({world}, {cell})."


def main() -> None:
    """Read the command line, and print the table while it grows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--all", action="store_true", help="all thirty cells")
    parser.add_argument("--only", default="", help="part of the name WORLD:CELL, such as room, or drift:s0.15/10")
    parser.add_argument("--runs", type=int, default=1, help="runs per figure, with other features and errors")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    given = parser.parse_args()
    several = cells(everything=given.all)
    named = [(cell, [world for world in WORLDS if given.only in f"{world.name}:{cell.name}"]) for cell in several]
    chosen = [(cell, worlds) for cell, worlds in named if worlds]
    if not chosen:
        parser.error(f"no cell is called {given.only}; one is {WORLDS[0].name}:{several[0].name}")
    worlds = [world for world in WORLDS if any(world in several for _, several in chosen)]
    systems = " / ".join(("default", "mono", *knowing(chosen[0][0])))
    heads = ["scale error", "length, keyframes", "own error", *(f"{world.name}: {systems}, m" for world in worlds)]
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}", flush=True)
    found = []
    for row in rows(chosen, given.runs):
        print(as_line(row, worlds), flush=True)
        found.append(row)
    print(verdict(found))
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
