"""Depth whose inverse has another scale and shift in every frame."""

import numpy as np
import pytest

from prgbd.core.alignment import fit_alignment
from prgbd.core.depth_kind import DepthKind
from prgbd.core.types import Frame, SlamResult
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from tests.plugins.slam.orb_gtsam.walls import CAMERA, path, view

FRAMES = 60
DRAWN = np.random.default_rng(3).standard_normal((FRAMES, 2)) * 0.3


def corrupted(frame: Frame) -> Frame:
    """Shift and scale inverse depth; the walls are 2 and 3.5 m away."""
    assert frame.depth is not None
    scale, shift = np.exp(DRAWN[frame.index, 0]), 0.25 + 0.2 * DRAWN[frame.index, 1]
    return frame.with_depth((1.0 / (scale * (1.0 / frame.depth + shift))).astype(np.float32))


def tracked(kind: DepthKind) -> SlamResult:
    with OrbGtsamSLAM() as system:
        system.expect_depth(kind)
        system.reset(CAMERA, "pseudo_rgbd", baseline=0.1, fps=10.0)
        for i, wTc in enumerate(path(FRAMES)):
            system.track(corrupted(view(i, wTc)))
        return system.finish()


@pytest.fixture(scope="module")
def found() -> SlamResult:
    return tracked(DepthKind.AFFINE_DISPARITY)


def test_the_path_is_that_of_a_camera_without_such_depth(found) -> None:
    assert len(found.trajectory) == FRAMES, "frames before the start get poses as well"
    truth = np.array(path(FRAMES))[found.trajectory.frame_index][:, :3, 3]
    moved = fit_alignment(found.trajectory.wTc[:, :3, 3], truth, "sim3").points(found.trajectory.wTc[:, :3, 3])
    assert np.sqrt(((moved - truth) ** 2).sum(1).mean()) < 0.02
    assert len(found.stats["starts"][0]["frames"]) == 2, "one frame's depth starts no map"


def test_the_shift_is_taken_out_of_the_depth_of_keyframes(found) -> None:
    seen, ratios = found.observations, []
    for k, wTc in enumerate(found.keyframes.wTc):
        rows = np.flatnonzero((seen.keyframe == k) & (seen.depth > 0))
        if len(rows) < 20:
            continue
        z = (np.linalg.inv(wTc) @ np.c_[found.points.xyz[seen.point[rows]], np.ones(len(rows))].T)[2]
        ratio = seen.depth[rows] / z
        near = z < 0.8 * np.median(z)
        if near.sum() < 50:
            continue  # a wall alone tells scale and shift no longer apart
        ratios.append(np.median(ratio[near]) / np.median(ratio[~near]))
    assert len(ratios) > 1
    np.testing.assert_allclose(ratios, 1.0, atol=0.05)


def test_depth_of_other_kinds_is_not_touched() -> None:
    assert len(tracked(DepthKind.SCALE).stats["starts"][0]["frames"]) == 1
