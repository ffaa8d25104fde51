r"""Do pose and depth help each other? Mono, pRGBD-Initial and pRGBD-Refined on all recordings at hand, as one table.

No option is set per recording. Every ATE (RMSE after Sim3) is the median over runs with slightly different numbers of
features, as single runs of a SLAM system scatter. Refined is the network that the loop's default recipe keeps, refined
once with the usual number of features; where it keeps the start, Refined is Initial. Abs Rel (median-scaled) stands
where the recording has true depth.

Examples:
    python benchmarks/coupling.py --data ../shared/data             # all that are there, and the synthetic worlds
    python benchmarks/coupling.py --only street --runs 1
    python benchmarks/coupling.py --columns mono,initial,as_it_is   # without the loop; depth taken as it is
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from coupling_recordings import RECORDINGS, Recording, network_of, opened
from slam_measuring import Source, make_source, measure, warm_up

import prgbd
from prgbd.core.data import Sequence
from prgbd.evaluation.trajectory import absolute_error
from prgbd.loop.loop_settings import SensingSettings
from prgbd.loop.monitor import SilentMonitor
from prgbd.plugins.slam.orb_gtsam.settings import FeatureOptions

READ_AHEAD = 1 << 29
COLUMNS: dict[str, tuple[str, dict[str, Any]]] = {
    "mono": ("mono", {}),
    "initial": ("pseudo_rgbd", {}),
    "refined": ("pseudo_rgbd", {}),
    "as_it_is": ("pseudo_rgbd", {"depth": {"follow": False}}),
}
USUAL = "mono,initial,refined"


def source_of(sequence: Sequence, mode: str, network: Mapping[str, str]) -> Source:
    """Predict depth where the mode asks for it."""
    percentile = SensingSettings().baseline_percentile
    return make_source(sequence, mode, range(len(sequence)), dict(network), None, percentile, READ_AHEAD)


def counts(sequence: Sequence, runs: int) -> list[int]:
    """Return numbers of features around the automatic one."""
    usual = FeatureOptions().count_in(sequence.camera.width, sequence.camera.height)
    return [round(usual * (1.0 + 0.05 * (i - runs // 2))) for i in range(runs)]


def refined(recording: Recording, sequence: Sequence, network: Mapping[str, str], folder: Path) -> dict[str, Any]:
    """Let the loop refine the network; return its weights, what was chosen, and Abs Rel before and after."""
    options = {name: value for name, value in network.items() if name != "id"}
    result = prgbd.improve(
        sequence,
        depth=(network["id"], options),
        out=folder,
        evaluation={"depth_cap": recording.depth_cap},
        monitor=SilentMonitor(),
    )
    errors = [loop["abs_rel"] for loop in result.loops]
    return {
        "weights": str(folder / "weights"),
        "kept_loop": result.best_loop,
        "abs_rel": [errors[0], errors[result.best_loop]],
        "recipe": [line for entry in result.summary.get("recipe") or () for line in entry["sentences"]],
    }


def measured(source: Source, options: Mapping[str, Any], sequence: Sequence, runs: int, label: str) -> dict[str, Any]:
    """Run SLAM with several numbers of features."""
    warm_up(source, options)
    made = [
        measure(source, {**options, "features": {"count": count}}, seed=0, label=label)
        for count in counts(sequence, runs)
    ]
    truth = np.asarray(sequence.poses)
    return {
        "ate": [round(absolute_error(run.result.trajectory, truth).rmse, 5) for run in made],
        "tracked": min(len(run.result.trajectory) for run in made),
        "fps": round(float(np.median([run.fps_with_finish for run in made])), 1),
    }


def rows(data: Path, only: str, runs: int, columns: list[str]) -> Iterator[dict[str, Any]]:
    """Measure recordings, one after the other."""
    for recording in (r for r in RECORDINGS if only in r.name):
        if recording.root and not (data / recording.root).is_dir():
            print(f"{recording.name}: skipped, there is no {data / recording.root}", file=sys.stderr)
            continue
        sequence, network = opened(recording, data), network_of(recording, data)
        row: dict[str, Any] = {"recording": recording.name, "frames": len(sequence)}
        with tempfile.TemporaryDirectory() as folder:
            for name in columns:
                mode, options = COLUMNS[name]
                if name == "refined":
                    row["loop"] = refined(recording, sequence, network, Path(folder) / "run")
                used = {**network, "weights": row["loop"].pop("weights")} if name == "refined" else network
                label = f"{recording.name}, {name}"
                row[name] = measured(source_of(sequence, mode, used), options, sequence, runs, label)
        yield row


def as_line(row: dict[str, Any], columns: list[str]) -> str:
    """Return a row of the table: median (range), frames tracked where not all are; Abs Rel before and after."""
    cells = []
    for name in columns:
        found = row[name]
        lost = "" if found["tracked"] == row["frames"] else f", {found['tracked']}/{row['frames']} frames"
        low, middle, high = (f(found["ate"]) for f in (min, np.median, max))
        scatter = f" ({low:.3g}-{high:.3g})" if len(found["ate"]) > 1 else ""
        cells.append(f"{middle:.3g}{scatter}{lost}")
    if "loop" in row:
        before, after = row["loop"]["abs_rel"]
        cells.append("-" if before is None else f"{before:.3f} → {after:.3f} ({(after - before) / before:+.0%})")
    return f"| {row['recording']} | {' | '.join(cells)} |"


def main() -> None:
    """Read the command line, and print the table while it grows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of the real recordings")
    parser.add_argument("--only", default="", help="part of a recording's name")
    parser.add_argument("--runs", type=int, default=5, help="runs per figure, with different numbers of features")
    parser.add_argument("--columns", default=USUAL, help=f"which of {', '.join(COLUMNS)} to measure")
    parser.add_argument("--json", type=Path, help="also write the figures to this file, after every recording")
    chosen = parser.parse_args()
    columns = chosen.columns.split(",")
    if unknown := [name for name in columns if name not in COLUMNS]:
        parser.error(f"there is no column {unknown[0]}; choose of {', '.join(COLUMNS)}")
    heads = [*(f"{name.replace('_', ' ')}: ATE, m" for name in columns), *(["Abs Rel"] if "refined" in columns else [])]
    print(f"| recording | {' | '.join(heads)} |\n|{'---|' * (len(heads) + 1)}")
    found = []
    for row in rows(chosen.data, chosen.only, chosen.runs, columns):
        print(as_line(row, columns), flush=True)
        found.append(row)
        if chosen.json:
            chosen.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
