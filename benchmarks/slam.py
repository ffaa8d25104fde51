"""Measure SLAM on a recording: accuracy, coverage, speed and the time of every stage, with a picture of the trajectory.

Examples:
    python benchmarks/slam.py seven_scenes mode=rgbd data.root=../shared/data/seven_scenes
    python benchmarks/slam.py kitti_odometry mode=mono data.root=../shared/data/kitti_odometry
    python benchmarks/slam.py kitti_odometry mode=pseudo_rgbd data.root=../shared/data/kitti_odometry \
        depth=rt_monodepth depth.weights=../shared/data/weights/rt_monodepth_s/ms_640_192
    python benchmarks/slam.py synthetic mode=rgbd data.scene=indoor data.sensor_depth=true slam.features=500

Options are ``group.name=value``; ``baseline=`` sets the baseline in metres, ``png=`` the picture, ``depth_percentile=``
which percentile of the predicted depth counts as the largest one (100: the paper's).
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

import prgbd
from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, PrgbdError
from prgbd.core.types import SlamResult, Trajectory

# ORB-SLAM2's TUM settings: bf = 40 at fx = 500.
KINECT_BASELINE = 0.08
KITTI_BASELINE_OF_DEPTH = 0.54 / 80.0


def options(arguments: list[str]) -> dict[str, Any]:
    """Read ``group.name=value`` arguments into nested dictionaries; values are YAML."""
    found: dict[str, Any] = {"data": {}, "slam": {}, "depth": {}}
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if not equals:
            raise ConfigError(f"'{argument}' is no option; write name=value.")
        group, dot, key = name.partition(".")
        if name in ("depth", "slam"):
            group, dot, key = name, ".", "id"
        (found[group] if dot else found)[key if dot else name] = yaml.safe_load(value)
    return found


def predict(sequence: Sequence, depth: dict[str, Any]) -> NDArray[np.float32]:
    """Predict inverse depth for every frame at the network's size, (N, h, w) float32."""
    import cv2

    chosen = dict(depth)
    estimator = prgbd.make_depth(chosen.pop("id", "rt_monodepth"), **chosen)
    height, width = estimator.input_size
    made = []
    for i in range(len(sequence)):
        predicted = estimator.predict(sequence.frame(i).image)
        made.append(cv2.resize(1.0 / predicted, (width, height), interpolation=cv2.INTER_AREA))
    return np.stack(made).astype(np.float32)


def ape(trajectory: Trajectory, truth: NDArray[np.float64]) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return the ATE (evo, Sim3 alignment), and true and aligned positions."""
    from evo.core.metrics import APE, PoseRelation, StatisticsType
    from evo.core.trajectory import PosePath3D

    known = np.isfinite(truth[trajectory.frame_index]).all(axis=(1, 2))
    reference = PosePath3D(poses_se3=list(truth[trajectory.frame_index[known]]))
    estimate = PosePath3D(poses_se3=list(trajectory.wTc[known]))
    estimate.align(reference, correct_scale=True)
    metric = APE(PoseRelation.translation_part)
    metric.process_data((reference, estimate))
    return metric.get_statistic(StatisticsType.rmse), reference.positions_xyz, estimate.positions_xyz


def draw(path: Path, truth: NDArray[np.float64], estimate: NDArray[np.float64], title: str) -> None:
    """Draw both trajectories from above (x, z) and from ahead (x, y)."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(13, 6))
    for axis, (u, v) in zip(axes, ((0, 2), (0, 1)), strict=True):
        axis.plot(truth[:, u], truth[:, v], "k-", label="truth")
        axis.plot(estimate[:, u], estimate[:, v], "r-", label="estimate (Sim3)")
        axis.set_aspect("equal", "datalim")
        axis.set_xlabel(f"{'xyz'[u]} [m]")
        axis.set_ylabel(f"{'xyz'[v]} [m]")
        axis.legend()
    figure.suptitle(title)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def run(sequence: Sequence, chosen: dict[str, Any]) -> tuple[SlamResult, float, float]:
    """Run SLAM; return the result, frames per second of tracking and mapping, and the seconds of the end."""
    mode = chosen.get("mode", "mono")
    baseline, inverse = chosen.get("baseline"), None
    if mode == "pseudo_rgbd":
        inverse = predict(sequence, chosen["depth"])
        lowest = np.percentile(inverse, 100.0 - float(chosen.get("depth_percentile", 100.0)))
        baseline = baseline or KITTI_BASELINE_OF_DEPTH / float(lowest)
    elif mode == "rgbd":
        baseline = baseline or KINECT_BASELINE
    import cv2

    slam = dict(chosen["slam"])
    with prgbd.make_slam(slam.pop("id", "orb_gtsam"), **slam) as system:
        system.reset(sequence.camera, "mono" if mode == "mono" else "rgbd", baseline=baseline, fps=sequence.fps)
        spent: list[float] = []
        for i in range(len(sequence)):
            frame = sequence.frame(i)
            if inverse is not None:
                size = (sequence.camera.width, sequence.camera.height)
                frame = frame.with_depth((1.0 / cv2.resize(inverse[i], size)).astype(np.float32))
            start = time.perf_counter()
            system.track(frame)
            spent.append(time.perf_counter() - start)
        start = time.perf_counter()
        result = system.finish()
        # The first frames load or compile kernels.
        return result, 1.0 / float(np.mean(spent[3:] or spent)), time.perf_counter() - start


def main(arguments: list[str]) -> int:
    """Run and print."""
    try:
        if not arguments or "=" in arguments[0]:
            raise ConfigError(f"Name a data plug-in first. {__doc__}")
        chosen = options(arguments[1:])
        sequence = prgbd.make_data(arguments[0], **chosen["data"])
        result, fps, end = run(sequence, chosen)
    except PrgbdError as error:
        print(error, file=sys.stderr)
        return 2
    title = f"{arguments[0]} {sequence.name}, {chosen.get('mode', 'mono')}"
    print(title)
    print(f"  tracked frames  {result.tracked_frames} of {result.frames}")
    print(f"  keyframes       {len(result.keyframes)} ({result.stats.get('keyframes_culled', 0)} culled)")
    print(f"  map points      {len(result.points)}")
    print(f"  speed           {fps:.1f} frames/s, {end:.1f} s at the end")
    if sequence.poses is not None and result.tracked_frames >= 3:
        rmse, truth, estimate = ape(result.trajectory, sequence.poses)
        print(f"  ATE RMSE        {rmse:.4f} m (Sim3 alignment, {len(truth)} poses)")
        picture = Path(chosen.get("png", f"{sequence.name.replace('/', '_')}_trajectory.png"))
        draw(picture, truth, estimate, f"{title}: ATE {rmse:.3f} m, {result.tracked_frames}/{result.frames} tracked")
        print(f"  picture         {picture}")
    for loop in result.stats.get("loops", []):
        where = ""
        if sequence.poses is not None:
            ends = sequence.poses[[loop["frame"], loop["loop_frame"]], :3, 3]
            where = f", truly {np.linalg.norm(ends[0] - ends[1]):.1f} m apart"
        print(
            f"  {loop['kind']:<15} frame {loop['frame']} at frame {loop['loop_frame']}{where}: {loop['inliers']} "
            f"inliers, scale {loop['scale']:.3f}, {loop['ms']:.0f} ms"
        )
    for stage, times in result.stats.get("stages_ms", {}).items():
        print(f"  {stage:<18}{times['median']:8.1f} ms median {times['max']:8.1f} max {times['runs']:6d} runs")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
