r"""Does pseudo depth help the pose? Mono, the default and depth as it is, on all recordings at hand, as one table.

No option is set per recording. Every figure is the median ATE (RMSE after Sim3) over runs with slightly different
numbers of features, as single runs of a SLAM system scatter.

Examples:
    python benchmarks/coupling.py --data ../shared/data             # all that are there, and the synthetic worlds
    python benchmarks/coupling.py --only street --runs 1
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from slam_measuring import Source, make_source, measure, warm_up

import prgbd
from prgbd.core.data import Sequence
from prgbd.evaluation.trajectory import absolute_error
from prgbd.plugins.slam.orb_gtsam.settings import FeatureOptions

DEMO = {"id": "monodepth2", "weights": "demo"}
RT = {"id": "rt_monodepth", "weights": "weights/rt_monodepth_s/ms_640_192"}
STREET_FRAMES, INDOOR_FRAMES = 120, 200
READ_AHEAD = 1 << 29
COUPLINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "mono": ("mono", {}),
    "default": ("pseudo_rgbd", {}),
    "as it is": ("pseudo_rgbd", {"depth": {"follow": False}}),
}


@dataclass(frozen=True)
class Recording:
    """A recording, its network, and where it is read from: ``root`` below the data folder, "" for a synthetic world."""

    name: str
    plugin: str
    root: str
    sequence: str | None
    network: dict[str, str]
    frames: int | None = None


RECORDINGS = (
    Recording("kitti_small", "kitti_odometry", "kitti_small", "00", RT),
    Recording("kitti00", "kitti_odometry", "kitti_odometry", "00", RT),
    Recording("redkitchen", "seven_scenes", "seven_scenes", None, DEMO),
    Recording("fr1rpy", "tum_rgbd", "tum_rgbd", None, DEMO),
    *(Recording(f"street-{i}", "synthetic", "", f"street-{i}", DEMO, STREET_FRAMES) for i in range(8)),
    *(Recording(f"indoor-{i}", "synthetic", "", f"indoor-{i}", DEMO, INDOOR_FRAMES) for i in range(2)),
)


def opened(recording: Recording, data: Path) -> Sequence:
    """Open a recording."""
    names = None if recording.sequence is None else [recording.sequence]
    if recording.root:
        return prgbd.make_sequences(recording.plugin, names, root=str(data / recording.root))[0]
    return prgbd.make_sequences(recording.plugin, names, frames=recording.frames)[0]


def source_of(recording: Recording, sequence: Sequence, mode: str, data: Path) -> Source:
    """Predict depth where the mode asks for it."""
    network = dict(recording.network)
    if network["weights"] != "demo":
        network["weights"] = str(data / network["weights"])
    return make_source(sequence, mode, range(len(sequence)), network, None, 100.0, READ_AHEAD)


def counts(sequence: Sequence, runs: int) -> list[int]:
    """Return numbers of features around the automatic one."""
    usual = FeatureOptions().count_in(sequence.camera.width, sequence.camera.height)
    return [round(usual * (1.0 + 0.05 * (i - runs // 2))) for i in range(runs)]


def rows(data: Path, only: str, runs: int) -> Iterator[dict[str, Any]]:
    """Measure recordings, one after the other."""
    for recording in (r for r in RECORDINGS if only in r.name):
        if recording.root and not (data / recording.root).is_dir():
            print(f"{recording.name}: skipped, there is no {data / recording.root}", file=sys.stderr)
            continue
        sequence = opened(recording, data)
        truth = np.asarray(sequence.poses)
        row: dict[str, Any] = {"recording": recording.name, "frames": len(sequence)}
        for name, (mode, options) in COUPLINGS.items():
            source = source_of(recording, sequence, mode, data)
            warm_up(source, options)
            made = [
                measure(source, {**options, "features": {"count": count}}, seed=0, label=f"{recording.name}, {name}")
                for count in counts(sequence, runs)
            ]
            row[name] = {
                "ate": [round(absolute_error(run.result.trajectory, truth).rmse, 5) for run in made],
                "tracked": min(len(run.result.trajectory) for run in made),
                "fps": round(float(np.median([run.fps_with_finish for run in made])), 1),
            }
        yield row


def as_line(row: dict[str, Any]) -> str:
    """Return a row of the table: median (range), frames tracked where not all are, frames per second."""
    cells = []
    for name in COUPLINGS:
        found = row[name]
        lost = "" if found["tracked"] == row["frames"] else f", {found['tracked']}/{row['frames']} frames"
        low, middle, high = (f(found["ate"]) for f in (min, np.median, max))
        cells.append(f"{middle:.3g} ({low:.3g}-{high:.3g}){lost}, {found['fps']:.0f} fps")
    return f"| {row['recording']} | {' | '.join(cells)} |"


def main() -> None:
    """Read the command line, and print the table while it grows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of the real recordings")
    parser.add_argument("--only", default="", help="part of a recording's name")
    parser.add_argument("--runs", type=int, default=5, help="runs per figure, with different numbers of features")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    chosen = parser.parse_args()
    print(f"| recording | {' | '.join(f'{name}: ATE, m' for name in COUPLINGS)} |\n|{'---|' * (len(COUPLINGS) + 1)}")
    found = []
    for row in rows(chosen.data, chosen.only, chosen.runs):
        print(as_line(row), flush=True)
        found.append(row)
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
