r"""Measure SLAM on a recording: accuracy, coverage, speed, memory and the time of every stage, with a picture.

Examples:
    python benchmarks/slam.py seven_scenes mode=rgbd data.root=../shared/data/seven_scenes
    python benchmarks/slam.py kitti_odometry mode=mono data.root=../shared/data/kitti_odometry --seeds 5
    python benchmarks/slam.py kitti_odometry mode=pseudo_rgbd data.root=../shared/data/kitti_odometry \
        depth=rt_monodepth depth.weights=../shared/data/weights/rt_monodepth_s/ms_640_192 slam.realtime=true
    python benchmarks/slam.py kitti_odometry mode=mono data.root=../shared/data/kitti_odometry \
        --compare orb_slam2=../shared/reference/trajectories/orb_slam2/kitti00_mono.tum --compare-fps 10
    python benchmarks/slam.py synthetic mode=rgbd data.frames=3000 data.sensor_depth=true --per 500

Settings are name=value: mode (mono, rgbd, stereo, pseudo_rgbd), baseline (metres, or running), depth_percentile (which
percentile of the predicted depth counts as the largest; 100 is the paper's), slam.*, data.* and depth.* for plug-ins.

What is counted: the wall time of every call of track, and of finish apart from it. Reading frames and predicting their
depth is not: the clock stands while --read-ahead MiB of frames are read, and a short run before the first seed loads or
compiles the kernels. With slam.realtime=true the mapper goes on while the next block is read; give a --read-ahead that
holds all frames for a rate without that advantage.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from slam_measuring import Measured, Source, make_source, measure, warm_up
from slam_pictures import draw
from slam_trajectories import Aligned, align, read_tum

import prgbd
from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, PrgbdError
from prgbd.core.types import Trajectory

FLAGS = ("seeds", "frames", "per", "json", "png", "compare", "compare_fps", "read_ahead")
SETTINGS = ("mode", "baseline", "depth_percentile", "slam", "depth")
OURS = "prgbd"


def parse(arguments: list[str]) -> tuple[argparse.Namespace, dict[str, Any]]:
    """Read the command line; flags may be written as name=value as well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="id of the data plug-in")
    parser.add_argument("settings", nargs="*", help="name=value")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="run seeds 0..N-1 and give the median")
    parser.add_argument("--frames", default="", metavar="A:B[:STEP]", help="use only these frames")
    parser.add_argument("--per", type=int, default=0, metavar="N", help="print the time of every N frames")
    parser.add_argument(
        "--compare", action="append", default=[], metavar="[NAME=]FILE.tum", help="another system's poses; repeatable"
    )
    parser.add_argument("--compare-fps", type=float, help="its frame is round(time * FPS); default: nearest time")
    parser.add_argument(
        "--read-ahead", type=int, default=1024, metavar="MIB", help="read this much ahead at a time (default 1024)"
    )
    parser.add_argument("--json", metavar="FILE", help="write the figures there too")
    parser.add_argument("--png", metavar="FILE", help="the picture (default: SEQUENCE_MODE.png)")
    flags = []
    for argument in arguments:
        name, equals, value = argument.partition("=")
        known = equals and not name.startswith("-") and name.replace("-", "_") in FLAGS
        flags += [f"--{name.replace('_', '-')}", value] if known else [argument]
    chosen = parser.parse_intermixed_args(flags)
    for name, least in (("seeds", 1), ("per", 0), ("read_ahead", 1)):
        if getattr(chosen, name) < least:
            raise ConfigError(f"--{name.replace('_', '-')} is {getattr(chosen, name)}; give at least {least}.")
    return chosen, read_settings(chosen.settings)


def read_settings(settings: list[str]) -> dict[str, Any]:
    """Read ``group.name=value`` arguments, with any number of dots, into nested dictionaries; values are YAML."""
    found: dict[str, Any] = {"data": {}, "slam": {}, "depth": {}}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals:
            raise ConfigError(f"'{setting}' is no setting; write name=value.")
        group, dot, key = name.partition(".")
        if name in ("depth", "slam"):
            group, dot, key = name, ".", "id"
        if dot and group not in found:
            raise ConfigError(f"'{setting}' belongs to no group; write data.*, slam.* or depth.*.")
        if not dot and name not in SETTINGS:
            raise ConfigError(f"There is no setting '{name}'; choose {', '.join(SETTINGS)}, slam.*, data.* or depth.*.")
        try:
            loaded = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ConfigError(f"The value of '{setting}' cannot be read as YAML; quote it.") from None
        node = found[group] if dot else found
        *parents, leaf = (key if dot else name).split(".")
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = loaded
    return found


def number(settings: dict[str, Any], name: str, most: float = math.inf) -> float | None:
    """Return a positive number out of the settings, None if it is not given.

    Raises:
        ConfigError: If it is none, or larger than ``most``.
    """
    value = settings.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= most:
        limit = "" if math.isinf(most) else f" of at most {most:g}"
        raise ConfigError(f"{name}={value} cannot be used; give a positive number{limit}.")
    return float(value)


def positions(text: str, count: int) -> range:
    """Return the frames that ``A:B[:STEP]`` names."""
    try:
        chosen = (
            range(count)[slice(*(int(part) if part else None for part in text.split(":")))] if text else range(count)
        )
    except (ValueError, TypeError):
        raise ConfigError(f"--frames is '{text}'; write A:B or A:B:STEP.") from None
    if len(chosen) < 2 or chosen.step < 1:
        raise ConfigError(f"--frames is '{text}', which leaves fewer than two frames of {count} in order.")
    return chosen


def errors_of(run: Measured, truth: NDArray[np.float64] | None, *, scale: bool = True) -> Aligned | None:
    """Return our error, None without truth or with fewer than three poses."""
    if truth is None or run.result.tracked_frames < 3:
        return None
    return align(run.result.trajectory, truth, scale=scale)


def figures(run: Measured, truth: NDArray[np.float64] | None) -> dict[str, Any]:
    """Return the figures of one run."""
    result, stats = run.result, run.result.stats
    sim3, se3 = errors_of(run, truth), errors_of(run, truth, scale=False)
    return {
        "tracked": result.tracked_frames,
        "frames": result.frames,
        "ate_sim3_m": None if sim3 is None else sim3.rmse,
        "ate_se3_m": None if se3 is None else se3.rmse,
        "scale": None if sim3 is None else sim3.scale,
        "fps": run.fps,
        "fps_with_finish": run.fps_with_finish,
        "tracking_cpu_ms": 1000.0 * float(np.mean(run.cpu_seconds)),
        "finish_s": run.finish_seconds,
        "peak_mib": run.peak_mib,
        "keyframes": len(result.keyframes),
        "keyframes_culled": stats.get("keyframes_culled"),
        "points": len(result.points),
        "maps": len(np.unique(result.keyframes.map_id)),
        "loops": len(stats.get("loops", [])),
    }


def print_figures(found: dict[str, Any], mode: str) -> None:
    """Print one run."""
    print(f"  tracked frames  {found['tracked']} of {found['frames']}")
    print(f"  keyframes       {found['keyframes']} ({found['keyframes_culled']} culled), {found['points']} map points")
    print(f"  maps, loops     {found['maps']}, {found['loops']}")
    if found["ate_sim3_m"] is not None:
        print(f"  ATE RMSE        {found['ate_sim3_m']:.4f} m (Sim3 alignment, scale {found['scale']:.3f})")
        if mode != "mono":
            print(f"                  {found['ate_se3_m']:.4f} m (SE3 alignment)")
    print(f"  speed           {found['fps']:.1f} frames/s ({found['fps_with_finish']:.1f} with the end)")
    print(f"  tracking thread {found['tracking_cpu_ms']:.1f} ms of CPU a frame")
    print(
        f"  at the end      {found['finish_s']:.1f} s; peak memory {found['peak_mib']:.0f} MiB with frames read ahead"
    )


def print_stages(run: Measured) -> None:
    """Print where the time goes."""
    total = 1000.0 * (float(run.seconds.sum()) + run.finish_seconds)
    print(f"  {'stage':<20}{'median':>9}{'mean':>9}{'max':>9} ms{'runs':>7}{'of wall time':>14}")
    for stage, times in run.result.stats.get("stages_ms", {}).items():
        share = times["mean"] * times["runs"] / total
        values = "".join(f"{times[name]:9.1f}" for name in ("median", "mean", "max"))
        print(f"  {stage:<20}{values}   {times['runs']:7d}{share:14.0%}")


def print_loops(run: Measured, truth: NDArray[np.float64] | None) -> None:
    """Print the loops and welded maps, and how far apart their ends truly are."""
    for loop in run.result.stats.get("loops", []):
        where = ""
        if truth is not None:
            ends = truth[[loop["frame"], loop["loop_frame"]], :3, 3]
            where = f", truly {np.linalg.norm(ends[0] - ends[1]):.1f} m apart"
        print(
            f"  {loop['kind']:<15} frame {loop['frame']} at frame {loop['loop_frame']}{where}: {loop['inliers']} "
            f"inliers, scale {loop['scale']:.3f}, {loop['ms']:.0f} ms"
        )


def print_blocks(run: Measured, size: int, positions: range) -> None:
    """Print the time of every ``size`` frames."""
    print("  time per frame")
    for start in range(0, len(run.seconds), size):
        block = run.seconds[start : start + size]
        first, last = positions[start], positions[start + len(block) - 1]
        print(f"    frames {first:5d}-{last:<5d} {1000 * block.mean():7.1f} ms")


def compare(ours: Aligned, others: dict[str, Aligned], truth: NDArray[np.float64], run: Measured) -> None:
    """Print other systems beside ours, each on its own frames and on those that both have."""
    print(f"  {'system':<22}{'frames':>8}{'ATE Sim3':>10}{'both have':>11}{'its ATE':>9}{'ours':>9}  (m)")
    print(f"  {OURS:<22}{len(ours.frames):8d}{ours.rmse:10.4f}")
    for name, other in others.items():
        common = np.intersect1d(ours.frames, other.frames)
        mine = align(run.result.trajectory, truth, scale=True, only=common)
        theirs = other.errors[np.isin(other.frames, common)]
        print(
            f"  {name:<22}{len(other.frames):8d}{other.rmse:10.4f}{len(common):11d}"
            f"{float(np.sqrt(np.mean(theirs**2))):9.4f}{mine.rmse:9.4f}"
        )


def read_others(chosen: argparse.Namespace, sequence: Sequence) -> dict[str, Trajectory]:
    """Read the other systems' trajectories by name; without ``NAME=`` that is the file's.

    Raises:
        ConfigError: If two have the same name, or the recording has no truth to compare with.
    """
    found: dict[str, Trajectory] = {}
    if chosen.compare and sequence.poses is None:
        raise ConfigError(f"--compare needs true poses, but the sequence '{sequence.name}' has none; drop it.")
    for text in chosen.compare:
        name, equals, file = text.partition("=")
        if not equals or Path(text).is_file():
            name, file = Path(text).stem, text
        if name in found or name == OURS:
            raise ConfigError(f"Two trajectories are named '{name}'; write --compare NAME={file} with another name.")
        found[name] = read_tum(Path(file), sequence.timestamps, chosen.compare_fps)
    return found


def middle_of(found: list[dict[str, Any]]) -> int:
    """Return the run with the (lower) median error; a run without an error is worse than any other."""
    errors = [one["ate_sim3_m"] if one["ate_sim3_m"] is not None else math.inf for one in found]
    return int(np.argsort(errors, kind="stable")[(len(found) - 1) // 2])


def print_seeds(found: list[dict[str, Any]], middle: int) -> None:
    """Print every seed, and what the worst of them did: a median hides a lost run."""
    for seed, one in enumerate(found):
        error = "no ATE, " if one["ate_sim3_m"] is None else f"ATE {one['ate_sim3_m']:.4f} m, "
        print(f"  seed {seed}: {error}{one['tracked']}/{one['frames']} tracked, {one['fps']:.1f} frames/s")
    fewest = min(one["tracked"] for one in found)
    print(f"  all seeds track at least {fewest} of {found[0]['frames']} frames; the median (seed {middle}):")


def report(
    chosen: argparse.Namespace, source: Source, runs: list[Measured], trajectories: dict[str, Trajectory]
) -> dict[str, Any]:
    """Print all runs, draw the median one and return the figures."""
    sequence, truth = source.sequence, source.sequence.poses
    found = [figures(run, truth) for run in runs]
    middle = middle_of(found)
    title = f"{chosen.data} {sequence.name}, {source.mode}"
    print(title)
    if len(runs) > 1:
        print_seeds(found, middle)
    print_figures(found[middle], source.mode)
    run = runs[middle]
    ours = errors_of(run, truth)
    if ours is not None and truth is not None:
        others = {name: align(other, truth, scale=True) for name, other in trajectories.items()}
        if others:
            compare(ours, others, truth, run)
        picture = Path(chosen.png or f"{sequence.name.replace('/', '_')}_{source.mode}.png")
        heading = f"{title}: ATE {ours.rmse:.3f} m, {run.result.tracked_frames}/{run.result.frames} tracked"
        named = {OURS: ours, **others}
        lost = [i for i, state in zip(source.positions, run.result.states, strict=True) if state != "ok"]
        frames = np.array(source.positions)
        draw(picture, truth[:, :3, 3], named, run.result.keyframes.frame_index, lost, frames, run.seconds, heading)
        print(f"  picture         {picture}")
    print_loops(run, truth)
    print_stages(run)
    if chosen.per:
        print_blocks(run, chosen.per, source.positions)
    return {"title": title, "runs": found, "median": middle, "stages_ms": run.result.stats.get("stages_ms", {})}


def main(arguments: list[str]) -> int:
    """Run and print."""
    try:
        chosen, settings = parse(arguments)
        sequence: Sequence = prgbd.make_data(chosen.data, **settings["data"])
        running = settings.get("mode") == "pseudo_rgbd" and settings.get("baseline") == "running"
        if running:
            del settings["baseline"]
        source = make_source(
            sequence,
            settings.get("mode", "mono"),
            positions(chosen.frames, len(sequence)),
            settings["depth"],
            number(settings, "baseline"),
            number(settings, "depth_percentile", 100.0) or 100.0,
            chosen.read_ahead << 20,
        )
        if running:
            source.baseline = None
        others = read_others(chosen, sequence)
        warm_up(source, settings["slam"])
        runs = [measure(source, settings["slam"], seed, f"seed {seed}") for seed in range(chosen.seeds)]
        found = report(chosen, source, runs, others)
        if chosen.json:
            Path(chosen.json).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    except PrgbdError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
