"""Depth whose scale wanders: the map keeps its shape, and gets the unit of all depths together."""

import numpy as np
import pytest

from prgbd.core.alignment import fit_alignment
from prgbd.core.types import Frame, SlamResult
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from tests.plugins.slam.orb_gtsam.walls import CAMERA, path, pose, view

FRAMES = 100
WANDER = 0.4 * np.sin(np.arange(FRAMES) / 8.0)


def wandering(frame: Frame) -> Frame:
    assert frame.depth is not None
    return frame.with_depth((frame.depth * np.exp(WANDER[frame.index])).astype(np.float32))


def tracked(**depth: bool | float | str) -> SlamResult:
    with OrbGtsamSLAM(depth=depth) as system:
        system.reset(CAMERA, "pseudo_rgbd", baseline=0.1, fps=10.0)
        for i, wTc in enumerate(path(FRAMES)):
            system.track(wandering(view(i, wTc)))
        return system.finish()


def error(result: SlamResult) -> float:
    """Root mean square distance to the true path after a similarity, metres."""
    truth = np.array(path(FRAMES))[result.trajectory.frame_index][:, :3, 3]
    found = result.trajectory.wTc[:, :3, 3]
    moved = fit_alignment(found, truth, "sim3").points(found)
    return float(np.sqrt(((moved - truth) ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def followed() -> SlamResult:
    return tracked()


def test_a_stiff_map_keeps_its_shape(followed) -> None:
    assert len(followed.trajectory) == FRAMES
    length = float(np.linalg.norm(np.diff(np.array(path(FRAMES))[:, :3, 3], axis=0), axis=1).sum())
    assert error(followed) < 0.02 * length
    assert error(followed) < 0.5 * error(tracked(sigma=0.0, shared=1.0, fallback=False))
    [note] = followed.stats["scale_drift"]
    assert note["geometry_sigma"] < note["network_sigma"], "which is why it keeps it"


def test_it_gets_the_unit_of_all_depths_together(followed) -> None:
    truth = np.array(path(FRAMES))[followed.trajectory.frame_index][:, :3, 3]
    scale = fit_alignment(followed.trajectory.wTc[:, :3, 3], truth, "sim3").scale
    unit = np.exp(np.mean(WANDER[followed.keyframes.frame_index]))
    assert 1.0 / scale == pytest.approx(unit, rel=0.1)


def test_depth_comes_out_as_it_was_measured(followed) -> None:
    ratio = np.array(followed.stats["depth_ratio"][1:], float)
    assert np.ptp(np.log(ratio)) == pytest.approx(np.ptp(WANDER), abs=0.15)
    seen, scales = followed.observations, []
    for k, wTc in enumerate(followed.keyframes.wTc):
        rows = np.flatnonzero((seen.keyframe == k) & (seen.depth > 0))
        cTw = np.linalg.inv(wTc)
        z = followed.points.xyz[seen.point[rows]] @ cTw[2, :3] + cTw[2, 3]
        scales.append(np.median(np.log(seen.depth[rows] / z)))
    drawn = WANDER[followed.keyframes.frame_index]
    np.testing.assert_allclose(scales - np.mean(scales), drawn - np.mean(drawn), atol=0.1)


def test_a_sensor_is_taken_as_it_is() -> None:
    options = OrbGtsamSLAM().settings.depth
    assert options.follows("pseudo_rgbd")
    assert not options.follows("rgbd")
    assert not options.follows("mono")
    assert not OrbGtsamSLAM(depth={"shared": 1.0}).settings.depth.follows("pseudo_rgbd"), "its weight was chosen"
    assert OrbGtsamSLAM(depth={"follow": True}).settings.depth.follows("rgbd")


@pytest.mark.parametrize("moves", [lambda i: pose(0.0), lambda i: pose(0.0, yaw=0.03 * i)], ids=["stands", "turns"])
def test_a_camera_without_parallax_ends_with_a_finite_map(moves) -> None:
    with OrbGtsamSLAM() as system:
        system.reset(CAMERA, "pseudo_rgbd", baseline=0.1, fps=2.0)
        for i in range(24):
            system.track(wandering(view(i, moves(i))))
        result = system.finish()
    assert len(result.trajectory) > 12
    assert np.isfinite(result.trajectory.wTc).all()
    assert np.isfinite(result.points.xyz).all()
