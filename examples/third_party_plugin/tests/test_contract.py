"""The plug-ins keep prgbd's contract."""

import numpy as np
import pytest

import prgbd
from prgbd.core.testing.conformance import planar_scene


def test_the_network_keeps_the_contract():
    prgbd.check_depth_estimator(prgbd.make_depth("example/unet", height=64, width=96))


def test_the_odometry_keeps_the_contract():
    result = prgbd.check_slam(prgbd.make_slam("example/rgbd_vo"))
    assert result.tracked_frames >= 8


def test_the_data_set_keeps_the_contract():
    prgbd.check_sequence(prgbd.make_data("example/wall"))


def test_the_parts_of_a_refinement_keep_the_contract():
    prgbd.check_loss(prgbd.make_loss("example/edge"))
    prgbd.check_criterion(prgbd.make_criterion("example/tracked", slack=0.01))
    prgbd.check_augmentation(prgbd.make_augmentation("example/dark"))


def test_the_odometry_measures_the_motion():
    frames = planar_scene(8)  # 3 pixels a frame to the right, 2 m in front of a wall
    camera = prgbd.PinholeCamera.from_fov(320, 240, 60.0)
    slam = prgbd.make_slam("example/rgbd_vo")
    slam.reset(camera, "rgbd", baseline=0.1)
    for frame in frames:
        slam.track(frame)
    last = slam.finish().trajectory.positions[-1]
    assert last == pytest.approx(np.array([7 * 3 * 2.0 / camera.fx, 0.0, 0.0]), abs=0.02)


def test_the_network_learns():
    import torch

    network = prgbd.make_depth("example/unet", height=32, width=64, channels=8, seed=1)
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    truth = torch.linspace(40.0, 2.0, 32)[None, None, :, None].expand(2, 1, 32, 64)
    noise = torch.rand((2, 3, 32, 64), generator=torch.Generator().manual_seed(0))
    images = 0.2 * noise + truth / 50  # the darker, the nearer
    errors = []
    for _ in range(30):
        error = (network(images).depth.log() - truth.log()).abs().mean()
        optimizer.zero_grad()
        error.backward()
        optimizer.step()
        errors.append(error.item())
    assert errors[-1] < 0.5 * errors[0]


def test_a_size_that_cannot_work_is_refused_in_one_sentence():
    with pytest.raises(prgbd.PrgbdError, match=r"depth\.height"):
        prgbd.make_depth("example/unet", height=50)
