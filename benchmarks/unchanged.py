r"""Does a change leave what the code computes as it was? Trajectories and figures before and after, and the speed.

Examples:
    python benchmarks/unchanged.py store before --data ../shared/data      # on the old code
    python benchmarks/unchanged.py compare before --data ../shared/data    # on the new code; fails beyond 1e-9
    python benchmarks/unchanged.py pair ../old --data ../shared/data       # speed against another checkout, in turn

Kernels that were just compiled may differ in the last digits from loaded ones, so let each code run once before.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from slam_measuring import make_source, measure, warm_up

import prgbd

TOLERANCE = 1e-9
DEMO_NETWORK = {"id": "monodepth2", "weights": "demo"}
EXPERIMENTS = ("smoke", "demo")
# Leaves of summary.json that tell when, where and how fast, not what.
_CIRCUMSTANCES = ("time", "second", "version", "folder", "path", "created", "finished", "started", "rate", "_ms", "fps")


@dataclass(frozen=True)
class Case:
    """A recording and the modes to run it in; ``folder`` of the data it needs, "" for none."""

    name: str
    plugin: str
    options: dict[str, Any]
    modes: tuple[str, ...]
    folder: str = ""
    network: dict[str, Any] = field(default_factory=lambda: dict(DEMO_NETWORK))


CASES = (
    Case("street-0", "synthetic", {"sequence": "street-0", "frames": 200}, ("mono", "pseudo_rgbd")),
    Case("street-0-sensor", "synthetic", {"sequence": "street-0", "frames": 200, "sensor_depth": True}, ("rgbd",)),
    Case("indoor-0", "synthetic", {"sequence": "indoor-0", "frames": 200}, ("mono", "pseudo_rgbd")),
    Case("indoor-0-sensor", "synthetic", {"sequence": "indoor-0", "frames": 200, "sensor_depth": True}, ("rgbd",)),
    Case(
        "kitti00",
        "kitti_odometry",
        {},
        ("mono", "pseudo_rgbd"),
        "kitti_odometry",
        {"id": "rt_monodepth", "weights": "weights/rt_monodepth_s/ms_640_192"},
    ),
    Case("kitti00-stereo", "kitti_odometry", {"stop": 21}, ("stereo",), "kitti_odometry"),
    Case("redkitchen", "seven_scenes", {"stop": 200}, ("mono", "rgbd", "pseudo_rgbd"), "seven_scenes"),
    Case("fr1rpy", "tum_rgbd", {}, ("mono", "rgbd", "pseudo_rgbd"), "tum_rgbd"),
)


def runs(data: Path, only: str) -> Iterator[tuple[str, dict[str, np.ndarray], float]]:
    """Run the cases whose name holds ``only``; yield name, arrays of the result, and frames per second."""
    for case in CASES:
        if case.folder and not (data / case.folder).is_dir():
            print(f"{case.name}: skipped, there is no {data / case.folder}")
            continue
        for mode in case.modes:
            if only in (name := f"{case.name}-{mode}"):
                yield name, *_run(case, mode, data)


def _run(case: Case, mode: str, data: Path) -> tuple[dict[str, np.ndarray], float]:
    root = {"root": str(data / case.folder)} if case.folder else {}
    sequence = prgbd.make_sequences(
        case.plugin,
        None if case.folder else [case.options["sequence"]],
        **root,
        **{name: value for name, value in case.options.items() if name != "sequence"},
    )[0]
    network = dict(case.network)
    if case.folder and network["weights"] != "demo":
        network["weights"] = str(data / network["weights"])
    source = make_source(sequence, mode, range(len(sequence)), network, None, 100.0, 1 << 30)
    warm_up(source, {})
    made = measure(source, {}, seed=0)
    trajectory, points = made.result.trajectory, made.result.points
    arrays = {"frames": trajectory.frame_index, "wTc": trajectory.wTc, "points": points.xyz}
    arrays["keyframes"] = made.result.keyframes.frame_index
    return arrays, made.fps


def figures(name: str) -> dict[str, float]:
    """Run an experiment as a user does; return the numbers of its summary that tell what it found."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "prgbd", f"experiment={name}", f"out={folder}/run"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        summary = json.loads((Path(folder) / "run" / "summary.json").read_text())
    return {
        key: value
        for key, value in _leaves(summary)
        if math.isfinite(value) and not any(word in key.lower() for word in _CIRCUMSTANCES)
    }


def _leaves(node: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from _leaves(value, f"{prefix}.{key}")
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield prefix, float(node)


def store(folder: Path, data: Path, only: str) -> None:
    """Keep what the code computes now in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, arrays, fps in runs(data, only):
        np.savez(folder / f"{name}.npz", **arrays)
        print(f"{name}: {len(arrays['frames'])} frames, {fps:.1f} fps")
    for name in (n for n in EXPERIMENTS if only in n):
        (folder / f"{name}.json").write_text(json.dumps(figures(name), indent=1))
        print(f"{name}: stored")


def compare(folder: Path, data: Path, only: str) -> bool:
    """Say how far what the code computes now is from what a folder holds; return whether it is nowhere too far."""
    worst = 0.0
    for name, arrays, fps in runs(data, only):
        with np.load(folder / f"{name}.npz") as before:
            difference = max(_difference(before[key], now) for key, now in arrays.items())
        worst = max(worst, difference)
        print(f"{name}: {difference:.1e} ({len(arrays['frames'])} frames, {fps:.1f} fps)", flush=True)
    for name in (n for n in EXPERIMENTS if only in n):
        before = json.loads((folder / f"{name}.json").read_text())
        now = figures(name)
        both = sorted(before.keys() & now.keys())
        far = {key: abs(before[key] - now[key]) for key in both}
        difference = max(far.values())
        worst = max(worst, difference)
        print(
            f"{name}: {difference:.1e} at {max(far, key=far.__getitem__)} ({len(both)} figures; "
            f"{len(before) - len(both)} gone, {len(now) - len(both)} new)",
            flush=True,
        )
    print(f"largest difference {worst:.1e}, allowed {TOLERANCE:.0e}")
    return worst <= TOLERANCE


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    if a.shape != b.shape:
        return math.inf
    return float(np.abs(a.astype(float) - b.astype(float)).max(initial=0.0))


def pair(other: Path, data: Path, only: str, rounds: int) -> None:
    """Time this code and another checkout's in turn, each in its own process; print the ratio of every case."""
    here = Path(__file__).resolve().parents[1]
    rates: dict[str, list[tuple[float, float]]] = {}
    for turn in range(rounds):
        checkouts = (here, other.resolve())
        both = {path: _rates(path, data, only) for path in (checkouts if turn % 2 == 0 else checkouts[::-1])}
        for name, rate in both[here].items():
            rates.setdefault(name, []).append((rate, both[other.resolve()][name]))
    for name, found in rates.items():
        ratios = [a / b for a, b in found]
        print(
            f"{name}: {np.median([a for a, _ in found]):.1f} fps, {np.median(ratios):.3f} of the other's "
            f"({min(ratios):.3f} to {max(ratios):.3f})"
        )


def _rates(checkout: Path, data: Path, only: str) -> dict[str, float]:
    """Frames per second of every case with the package of a checkout, as this file runs it."""
    python = checkout / ".venv" / "bin" / "python"
    command = [
        str(python if python.exists() else sys.executable),
        __file__,
        "rates",
        "-",
        "--data",
        str(data.resolve()),
    ]
    environment = {**os.environ, "PYTHONPATH": f"{checkout}{os.pathsep}{Path(__file__).parent}"}
    done = subprocess.run([*command, "--only", only], check=True, capture_output=True, text=True, env=environment)
    made: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return made


def main() -> None:
    """Read the command line and do what it says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("store", "compare", "pair", "rates"))
    parser.add_argument("folder", type=Path, help="where the stored results lie; for pair, the other checkout")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of the real recordings")
    parser.add_argument("--only", default="", help="part of the names of the cases to run")
    parser.add_argument("--rounds", type=int, default=5, help="of pair")
    chosen = parser.parse_args()
    if chosen.action == "store":
        store(chosen.folder, chosen.data, chosen.only)
    elif chosen.action == "compare":
        sys.exit(0 if compare(chosen.folder, chosen.data, chosen.only) else 1)
    elif chosen.action == "pair":
        pair(chosen.folder, chosen.data, chosen.only, chosen.rounds)
    else:
        print(json.dumps({name: fps for name, _, fps in runs(chosen.data, chosen.only)}))


if __name__ == "__main__":
    main()
