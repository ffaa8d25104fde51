"""Self-calibration on maps whose true focal length is known."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, inverse
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.mapping.self_calibration import calibrate_focal_length, self_calibrate
from prgbd.plugins.slam.orb_gtsam.optimisation.make_solver import make_solver

POINTS = 300
SIGMA = 0.01
SOLVER = make_solver("numba")


def pinhole(focal: float) -> PinholeCamera:
    return PinholeCamera(640, 480, focal, focal, 320.0, 240.0)


def made(
    true: float, given: float, *, turning: bool, keyframes: int = 24, radial: float = 0.0
) -> tuple[Map, CameraModel]:
    """Observe a cloud with the true focal length, and place it with noise."""
    rng = np.random.default_rng(5)
    xyz = np.stack([rng.uniform(-6, 6, POINTS), rng.uniform(-3, 3, POINTS), rng.uniform(-6, 6, POINTS)], axis=1)
    slam_map = Map(POINTS, 1, np.ones(1))
    camera = CameraModel(pinhole(given), True, 0.0, 0.0, np.ones(1), 1)
    ids = None
    for k in range(keyframes):
        # Round the cloud, or straight towards it.
        angle = 0.06 * k if turning else 0.0
        distance = 14.0 if turning else 20.0 - 0.3 * k
        wTc = inverse(exp_se3(np.array([0.0, angle, 0.0, 0.0, 0.0, 0.0])))
        wTc[:3, 3] = -distance * wTc[:3, 2]
        cTw = inverse(wTc)
        ideal = pinhole(true).project(xyz @ cTw[:3, :3].T + cTw[:3, 3]) - (320, 240)
        # What a lens does whose images are straightened by ``radial``, but for terms in its square.
        seen_at = ideal * (1 - radial * ((ideal / true) ** 2).sum(axis=1, keepdims=True)) + (320, 240)
        uv = seen_at + rng.normal(0, 0.4, (POINTS, 2))
        none = np.zeros(POINTS, np.float32)
        seen = Features(
            uv.astype(np.float32),
            np.zeros(POINTS, np.int32),
            none,
            np.zeros((POINTS, 4), np.uint64),
            none,
            none - 1,
            np.zeros((POINTS, 3), np.uint8),
            np.zeros(2, np.int32),
        )
        first = np.full(POINTS, -1, np.int64) if ids is None else ids
        row = slam_map.add_keyframe(k, 0.1 * k, exp_se3(rng.normal(0, 1e-3, 6)) @ cTw, seen, first)
        if ids is None:
            ids = slam_map.add_points(row, np.arange(POINTS), xyz + rng.normal(0, 0.02, xyz.shape))
    return slam_map, camera


def length(slam_map: Map) -> float:
    centre = slam_map.keyframes.centre[: slam_map.keyframes.count]
    return float(np.linalg.norm(np.diff(centre, axis=0), axis=1).sum())


@pytest.mark.parametrize(("given", "solver"), [(490.0, "numba"), (510.0, "numba"), (490.0, "gtsam")])
def test_a_turning_camera_finds_its_focal_length(given: float, solver: str) -> None:
    slam_map, camera = made(500.0, given, turning=True)
    before = length(slam_map)
    found = calibrate_focal_length(slam_map, camera, make_solver(solver), 0, SIGMA)
    assert found is not None
    assert camera.pinhole.fx == pytest.approx(500.0, rel=2e-3)
    assert camera.pinhole.fy == camera.pinhole.fx
    assert found.factor == pytest.approx(500.0 / given, rel=2e-3)
    assert abs(camera.pinhole.fx / 500.0 - 1.0) < 4.0 * found.deviation
    assert length(slam_map) == pytest.approx(before, rel=1e-6)


@pytest.mark.parametrize("radial", [-0.025, 0.025])
def test_distortion_that_is_left_in_the_images_is_found_and_taken_out(radial: float) -> None:
    slam_map, camera = made(500.0, 500.0, turning=True, radial=radial)
    ideal, _ = made(500.0, 500.0, turning=True)
    n = slam_map.keyframes.count
    before = np.abs(slam_map.keyframes.uv[:n] - ideal.keyframes.uv[:n]).mean()
    found = calibrate_focal_length(slam_map, camera, SOLVER, 0, SIGMA)
    assert found is not None
    # 300 points leave much of it to the images' word that there is none.
    assert 0.4 < found.radial / radial < 1.2
    assert camera.pinhole.fx == pytest.approx(500.0, rel=8e-3)
    assert np.abs(slam_map.keyframes.uv[:n] - ideal.keyframes.uv[:n]).mean() < 0.7 * before


def test_the_map_fits_its_observations_afterwards() -> None:
    slam_map, camera = made(500.0, 490.0, turning=True)
    assert calibrate_focal_length(slam_map, camera, SOLVER, 0, SIGMA) is not None
    kf, pts = slam_map.keyframes, slam_map.points
    errors = []
    for k in range(kf.count):
        cTw = kf.cTw[k]
        p = pts.xyz[kf.point[k]] @ cTw[:3, :3].T + cTw[:3, 3]
        errors.append(camera.pinhole.project(p) - kf.uv[k])
    assert float(np.sqrt(np.mean(np.square(errors)))) < 0.45


@pytest.mark.parametrize(
    ("given", "turning"),
    [(490.0, False), (500.0, True), (503.0, True)],
    ids=["straight ahead", "right", "nearly right"],
)
def test_without_reason_nothing_changes(given: float, turning: bool) -> None:
    slam_map, camera = made(500.0, given, turning=turning)
    poses, points = slam_map.keyframes.cTw.copy(), slam_map.points.xyz.copy()
    assert self_calibrate(slam_map, camera, SOLVER, SIGMA) == {"refined": False}
    assert camera.pinhole.fx == given
    assert np.array_equal(slam_map.keyframes.cTw, poses)
    assert np.array_equal(slam_map.points.xyz, points)


def test_the_largest_map_decides() -> None:
    slam_map, camera = made(500.0, 490.0, turning=True)
    slam_map.keyframes.map_id[:20] = 1
    found = self_calibrate(slam_map, camera, SOLVER, SIGMA)
    assert found["refined"]
    assert found["factor"] == pytest.approx(500.0 / 490.0, rel=3e-3)


def test_few_keyframes_are_not_asked() -> None:
    slam_map, camera = made(500.0, 490.0, turning=True, keyframes=6)
    assert calibrate_focal_length(slam_map, camera, SOLVER, 0, SIGMA) is None
    assert camera.pinhole.fx == 490.0


def test_pseudo_depth_has_no_say_and_keeps_its_measurements() -> None:
    slam_map, camera = made(500.0, 490.0, turning=True)
    pixels_alone, mono = made(500.0, 490.0, turning=True)
    camera.mono, camera.baseline = False, 0.5
    wrong = np.random.default_rng(0).uniform(5.0, 40.0, slam_map.keyframes.u_right[: slam_map.keyframes.count].shape)
    slam_map.keyframes.u_right[: slam_map.keyframes.count] = (
        slam_map.keyframes.uv[: slam_map.keyframes.count, :, 0] - wrong
    )
    bf = camera.bf
    found = calibrate_focal_length(slam_map, camera, SOLVER, 0, SIGMA)
    assert found == calibrate_focal_length(pixels_alone, mono, SOLVER, 0, SIGMA)
    assert camera.pinhole.fx == pytest.approx(500.0, rel=2e-3)
    assert camera.bf == pytest.approx(bf)  # a right column still means the depth that was measured
