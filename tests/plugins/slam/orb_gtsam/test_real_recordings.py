"""The SLAM system on real recordings of ../shared, against measured and motion-captured truth.

Without them the synthetic scenes of ``tracking/test_tracking.py`` stand in.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from tests.plugins.slam.orb_gtsam.walls import error

Source = Callable[[int], Frame]


@pytest.fixture(scope="module")
def kitchen(shared_data: Callable[[str], Path]) -> tuple[Source, np.ndarray]:
    folder = shared_data("seven_scenes/redkitchen/seq-01")

    def frame(i: int) -> Frame:
        image = cv2.cvtColor(cv2.imread(str(folder / f"frame-{i:06d}.color.jpg")), cv2.COLOR_BGR2RGB)
        depth = cv2.imread(str(folder / f"frame-{i:06d}.depth.png"), cv2.IMREAD_UNCHANGED)
        metres = np.where(depth == 65535, 0, depth).astype(np.float32) / 1000
        return Frame(i, i / 30.0, np.asarray(image, np.uint8), metres)

    poses = np.stack([np.loadtxt(folder / f"frame-{i:06d}.pose.txt") for i in range(240)])
    return frame, poses


@pytest.fixture(scope="module")
def kitti(shared_data: Callable[[str], Path]) -> tuple[Source, np.ndarray, PinholeCamera]:
    folder = shared_data("kitti_odometry")
    rows = np.loadtxt(folder / "poses" / "00.txt")[:40]
    poses = np.concatenate([rows.reshape(-1, 3, 4), np.tile([[[0, 0, 0, 1.0]]], (len(rows), 1, 1))], axis=1)
    line = (folder / "sequences" / "00" / "calib.txt").read_text().splitlines()[0]
    P = np.array(line.split()[1:], float).reshape(3, 4)

    def frame(i: int) -> Frame:
        image = cv2.imread(str(folder / "sequences" / "00" / "image_0" / f"{i:06d}.png"), cv2.IMREAD_COLOR)
        return Frame(i, i / 10.0, np.asarray(image, np.uint8))

    return frame, poses, PinholeCamera(1241, 376, P[0, 0], P[1, 1], P[0, 2], P[1, 2])


def run(frames: list[Frame], camera: PinholeCamera, mode: str, baseline: float | None, fps: float) -> SlamResult:
    with OrbGtsamSLAM() as system:
        system.reset(camera, mode, baseline=baseline, fps=fps)
        for frame in frames:
            system.track(frame)
        return system.finish()


@pytest.mark.parametrize(
    ("mode", "indices"), [("rgbd", range(0, 240, 2)), ("rgbd", range(239, 0, -4)), ("mono", range(0, 240, 2))]
)
def test_kitchen_is_tracked_to_centimetres(kitchen, mode, indices) -> None:
    source, poses = kitchen
    camera = PinholeCamera(640, 480, 525.0, 525.0, 320.0, 240.0)
    frames = [Frame(n, n / 15.0, (f := source(i)).image, f.depth) for n, i in enumerate(indices)]
    result = run(frames, camera, mode, None if mode == "mono" else 0.08, 15.0)
    assert result.tracked_frames == len(frames)
    truth = np.stack([poses[indices[n]][:3, 3] for n in result.trajectory.frame_index])
    assert error(result.trajectory.positions, truth, scale=True) < 0.05


@pytest.mark.parametrize("stride", [1, 3], ids=["town", "motorway"])
def test_a_street_is_tracked_without_depth(kitti, stride: int) -> None:
    source, poses, camera = kitti
    indices = range(0, len(poses), stride)
    result = run([source(i) for i in indices], camera, "mono", None, 10.0)
    assert result.tracked_frames == len(indices)
    assert error(result.trajectory.positions, poses[indices, :3, 3], scale=True) < 0.3
