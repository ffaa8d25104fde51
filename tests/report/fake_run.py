"""A run folder made by code: small but real arrays, through the program's own writers and metrics."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prgbd.core.types import Keyframes, MapPoints, Observations, PinholeCamera, SlamResult, Trajectory
from prgbd.evaluation.depth import DepthEvaluation
from prgbd.evaluation.trajectory import evaluate_trajectory
from prgbd.io.export import save_result
from prgbd.io.files import write_json
from prgbd.io.trajectory_files import write_tum

HEIGHT, WIDTH, FRAMES = 48, 80, 150
TERMS = ("photometric", "smoothness", "depth_consistency", "depth_transfer")


def true_poses(frames=FRAMES, seed=0):
    """A loop through a street, (frames, 4, 4): x right, y down, z forward; about 150 m long."""
    angle = np.linspace(0, 2 * np.pi, frames)
    size = 1 + 0.25 * np.sin(3 * angle + seed)
    wTc = np.tile(np.eye(4), (frames, 1, 1))
    wTc[:, :3, 3] = np.stack([24 * size * (1 - np.cos(angle)), 0.2 * np.sin(angle), 24 * size * np.sin(angle)], axis=1)
    heading = np.gradient(wTc[:, :3, 3], axis=0)
    wTc[:, :3, :3] = Rotation.from_euler("y", np.arctan2(heading[:, 0], heading[:, 2])[:, None]).as_matrix()
    return wTc


def slam_result(truth, timestamps, error, lost=(), seed=0):
    """An estimate at half scale whose drift grows to about ``error`` metres, with a map around it."""
    rng = np.random.default_rng(seed)
    frames = np.array([f for f in range(len(truth)) if f not in set(lost)])
    drift = np.cumsum(rng.normal(size=(len(truth), 3)), axis=0)
    drift *= error / max(np.abs(drift).max(), 1e-9)
    wTc = truth.copy()
    wTc[:, :3, 3] = 0.5 * (wTc[:, :3, 3] + drift)
    keyframes = frames[::8]
    around = wTc[rng.choice(keyframes, 800), :3, 3] + rng.normal(size=(800, 3)) * [3, 1, 3]
    states = np.where(np.isin(np.arange(len(truth)), frames), "ok", "lost").tolist()
    inliers = np.where(np.array(states) == "ok", rng.integers(120, 320, len(truth)), 0).astype(np.int32)
    no = np.zeros(0, np.int64)
    return SlamResult(
        camera=PinholeCamera(WIDTH, HEIGHT, 60, 60, 39.5, 23.5),
        mode="rgbd",
        frames=len(truth),
        trajectory=Trajectory(frames, timestamps[frames], wTc[frames]),
        keyframes=Keyframes(keyframes, timestamps[keyframes], wTc[keyframes], np.zeros(len(keyframes), np.int32)),
        points=MapPoints(around, rng.integers(0, 256, (800, 3), np.uint8)),
        observations=Observations(no, no, np.zeros((0, 2), np.float32), np.zeros(0, np.float32)),
        states=states,
        inliers=inliers,
        online=Trajectory(frames, timestamps[frames], wTc[frames]),
        stats={"track_ms": 12.5},
    )


def scene(index):
    """An image and its depth: a road between walls, with a box in front."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    depth = np.minimum(60, 3 + 300 / (np.abs(v - 20) * 1.6 + np.abs(u - 40 + 5 * np.sin(index)) * 0.8 + 6))
    box = (np.abs(u - 20 - 4 * index) < 9) & (np.abs(v - 28) < 9)
    depth[box] = 6
    shade = 255 * np.exp(-depth / 30) * (0.75 + 0.25 * np.sin(u * 0.9) * np.cos(v * 1.1))
    image = np.stack([shade, shade * 0.9, shade * 0.75 + 30], axis=-1)
    image[box] = image[box] * [1.0, 0.45, 0.4] + 20
    depth[:6] = 0
    return np.clip(image, 0, 255).astype(np.uint8), depth.astype(np.float32)


def write_samples(path, error, truth=True, count=3):
    """Write samples whose relative error is about ``error`` and return the depth figures of these very maps."""
    rng = np.random.default_rng(5)
    scenes = [scene(i) for i in range(count)]
    images, depths = (np.stack(part) for part in zip(*scenes, strict=True))
    rough = np.stack([np.kron(rng.normal(size=(6, 10)), np.ones((8, 8))) for _ in range(count)])
    predicted = (np.where(depths > 0, depths, 50) * np.exp(error * rough) / 3).astype(np.float32)
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {"images": images, "depth": predicted, "frame_index": np.arange(count) * 40}
    arrays["sequence"] = np.array(["street-a"] * count)
    if truth:
        arrays["truth"] = depths
    np.savez_compressed(path, **arrays)
    evaluation = DepthEvaluation(caps=(30, 80), bins=(0, 10, 30, 80))
    for gt, pred in zip(depths, predicted, strict=True):
        evaluation.add(gt, pred)
    return evaluation.result()


def write_losses(path, start, steps=60):
    rng = np.random.default_rng(int(start * 100))
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [",".join(("step", "epoch", "total", *TERMS))]
    for step in range(steps):
        terms = [start * w * np.exp(-step / 80) * rng.uniform(0.8, 1.2) for w in (0.4, 0.002, 1.0, 0.6)]
        lines.append(",".join([str(step), "0", *(f"{v:.6g}" for v in (sum(terms), *terms))]))
    path.write_text("\n".join(lines) + "\n")


def make_run(
    folder: Path,
    pose_errors=(4.0, 1.5),
    depth_errors=(0.35, 0.2),
    sequences=("street-a",),
    truth=True,
    lost=(40, 41, 42),
    task="self_improve",
    **summary,
):
    """Write a run folder with one loop per pose error; returns its path.

    ``lost`` frames are lost in the first loop only. ``summary`` overrides entries of summary.json.
    """
    timestamps = 1000 + np.arange(FRAMES) / 10
    loops = []
    for k, error in enumerate(pose_errors):
        loop = {"loop": k, "name": "pRGBD-Initial" if k == 0 else "pRGBD-Refined", "pose": {}, "depth": None}
        base = folder / "loops" / f"{k:02d}"
        for s, name in enumerate(sequences):
            poses = true_poses(seed=s)
            result = slam_result(poses, timestamps, error, lost if k == 0 else (), seed=s + 10 * k)
            save_result(result, base / "slam" / name)
            figures = evaluate_trajectory(result.trajectory, FRAMES, poses if truth else None, timestamps)
            counts = {
                "keyframes": len(result.keyframes),
                "points": len(result.points),
                "lost_frames": len(lost) * (k == 0),
            }
            loop["pose"][name] = figures | counts | {"fps": 11.25}
            if truth:
                write_tum(Trajectory(np.arange(FRAMES), timestamps, poses), folder / "truth" / f"{name}.tum")
        if depth_errors:
            loop["depth"] = write_samples(base / "depth" / "samples.npz", depth_errors[k], truth)
            loop["baseline"] = dict.fromkeys(sequences, 0.54)
            loop["depth_max"] = dict.fromkeys(sequences, 80.0)
            if k + 1 < len(pose_errors):
                write_losses(base / "training" / "losses.csv", 1.0 / (k + 1))
                held_out = {"held_out_before": 0.9 / (k + 1), "held_out_after": 0.7 / (k + 1)}
                loop["training"] = held_out | {"samples": 120, "seconds": 31.5}
        loops.append(loop)
    content = {
        "schema": 1,
        "prgbd": "0.1.0",
        "task": task,
        "slam": "orb_gtsam",
        "depth": "monodepth2" if depth_errors else None,
        "data": "synthetic",
        "sequences": list(sequences),
        "seed": 0,
        "loops": loops,
        "stop": {"reason": "The 2 refinements that task.max_loops allows were made.", "best_loop": len(loops) - 1},
        "versions": {"python": "3.11", "torch": "2.13"},
        "seconds": 312.4,
    }
    write_json(folder / "summary.json", content | summary)
    (folder / "config.yaml").write_text("seed: 0\nslam:\n  id: orb_gtsam\nloss:\n  depth_transfer: 1.0\n")
    (folder / "run.log").write_text("started\nended\n")
    return folder
