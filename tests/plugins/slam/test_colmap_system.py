"""``slam=colmap``: offline structure from motion on small made-up recordings."""

import numpy as np
import pytest

pytest.importorskip("pycolmap", reason="slam=colmap comes with the extra 'colmap'")

import prgbd
from prgbd.core.errors import ConfigError, SlamError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.evaluation.trajectory import evaluate_trajectory
from prgbd.plugins.slam.colmap import ColmapSLAM
from prgbd.plugins.slam.colmap.completion import interpolate
from tests.contracts import SlamContract


class TestContract(SlamContract):
    @pytest.fixture
    def system(self):
        return ColmapSLAM(every=1, threads=1, init_min_tri_angle=1.0)


@pytest.fixture(scope="module")
def world():
    return prgbd.make_data("synthetic", sequence="indoor-0", frames=24, width=320, height=240)


def reconstructed(world, mode, **options):
    with prgbd.make_slam("colmap", every=2, threads=1, **options) as system:
        system.reset(world.camera, mode, baseline=None if mode == "mono" else 0.08, fps=world.fps)
        for i in range(len(world)):
            frame = world.frame(i)
            system.track(frame.with_depth(world.depth(i) if mode == "rgbd" else None))
        return system.finish()


def test_depth_fixes_the_scale_and_frames_between_are_marked(world):
    result = reconstructed(world, "rgbd")
    figures = evaluate_trajectory(result.trajectory, len(world), world.poses, world.timestamps, alignment="se3")
    assert result.tracked_frames >= 0.9 * len(world)
    assert figures["ate_rmse"] < 0.02
    between = result.stats["interpolated_frames"]
    assert len(between) > 5
    assert set(between).isdisjoint(result.keyframes.frame_index.tolist())
    seen = result.camera.project(
        np.einsum(
            "mij,mj->mi",
            np.linalg.inv(result.keyframes.wTc)[result.observations.keyframe],
            np.c_[result.points.xyz, np.ones(len(result.points))][result.observations.point],
        )[:, :3]
    )
    assert np.median(np.linalg.norm(seen - result.observations.uv, axis=1)) < 1.0


def test_an_unknown_camera_is_estimated(world):
    result = reconstructed(world, "mono", intrinsics="unknown")
    assert result.camera.fx == pytest.approx(world.camera.fx, rel=0.1)
    assert result.stats["camera"]["fx"] == result.camera.fx


def test_nothing_registered_is_one_sentence():
    system = ColmapSLAM(every=1, threads=1)
    system.reset(PinholeCamera.from_fov(96, 64, 60.0), "mono")
    for i in range(3):
        system.track(Frame(i, 0.1 * i, np.zeros((64, 96, 3), np.uint8)))
    folder = system._path
    with pytest.raises(SlamError, match=r"could not register any of 3 keyframes.*slam.every"):
        system.finish()
    system.close()
    assert not folder.exists()


@pytest.mark.parametrize("options", [{"every": 0}, {"intrinsics": "guess"}, {"threads": 1.5}])
def test_options_that_cannot_work_are_refused(options):
    with pytest.raises(ConfigError, match=f"slam.{next(iter(options))}"):
        ColmapSLAM(**options)


def test_poses_between_neighbours_follow_time_and_wide_gaps_stay_open():
    wTc = np.tile(np.eye(4), (3, 1, 1))
    wTc[:, 0, 3] = [0.0, 4.0, 8.0]
    stamps = np.array([0.0, 1.0, 4.0, 5.0, 6.0, 7.0, 8.0])
    frames, poses = interpolate(np.array([0, 2, 6]), wTc, stamps, gap=2)
    assert frames.tolist() == [0, 1, 2, 6]
    assert np.allclose(poses[:, 0, 3], [0.0, 1.0, 4.0, 8.0])
