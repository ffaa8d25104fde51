"""``slam=posenet``: the motions of a pose network, chained."""

import numpy as np
import pytest
import torch
from torch import nn

import prgbd
from prgbd.core.errors import ConfigError, WeightsError
from prgbd.core.types import Frame, PinholeCamera
from prgbd.plugins.slam.posenet import PoseNetworkOdometry
from tests.contracts import SlamContract


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A small Monodepth2 whose pose network is not the fresh one."""
    folder = tmp_path_factory.mktemp("monodepth2")
    network = prgbd.make_depth("monodepth2", height=64, width=96)
    pose = network.pose_network()
    with torch.no_grad():
        pose.decoder.net[3].bias += torch.linspace(0.5, 1.5, 12)
    network.save_weights(folder)
    return folder


class TestContract(SlamContract):
    @pytest.fixture
    def system(self, weights):
        return PoseNetworkOdometry(weights=weights)


class Told(nn.Module):
    """A pose network that reads the motion from the images' first pixel: what it says is known."""

    motions: dict[tuple[int, int], torch.Tensor]

    def forward(self, first, second):
        pair = tuple(round(float(image[0, 0, 0, 0]) * 255) for image in (first, second))
        return self.motions[pair][None]


def rigid(angle, translation):
    T = torch.eye(4, dtype=torch.float64)
    c, s = np.cos(angle), np.sin(angle)
    T[:3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    T[:3, 3] = torch.tensor(translation)
    return T


def test_chained_motions_give_back_the_poses(weights, tmp_path):
    """True poses -> relative motions as a pose network says them (secondTfirst) -> the same poses."""
    wTc = [rigid(0.1 * i, [0.2 * i, 0.01 * i * i, 1.0 * i]) for i in range(6)]
    system = PoseNetworkOdometry(weights=weights, keyframe_every=2)
    system._pose = Told()
    # temporal order, and only that: a pair the other way round is not in the table
    system._pose.motions = {(i, i + 1): (torch.linalg.inv(wTc[i + 1]) @ wTc[i]).float() for i in range(5)}
    system.reset(PinholeCamera.from_fov(96, 64, 60.0), "mono")
    for i in range(6):
        tracked = system.track(Frame(i, 0.1 * i, np.full((64, 96, 3), i, np.uint8)))
        assert np.allclose(tracked.wTc, wTc[i], atol=1e-5)
    result = system.finish()
    assert np.allclose(result.trajectory.wTc, torch.stack(wTc).numpy(), atol=1e-5)
    assert result.keyframes.frame_index.tolist() == [0, 2, 4]
    assert len(result.points) == 0
    prgbd.save_result(result, tmp_path, ("tum", "kitti", "ply", "colmap"))
    assert np.array_equal(prgbd.load_result(tmp_path).trajectory.wTc, result.trajectory.wTc)


def test_weights_without_a_pose_network_are_refused(tmp_path):
    prgbd.make_depth("monodepth2", height=64, width=96).save_weights(tmp_path)
    with pytest.raises(WeightsError, match=r"hold no pose network.*pose_encoder.pth"):
        prgbd.make_slam("posenet", weights=tmp_path)


@pytest.mark.parametrize(
    ("options", "words"),
    [({}, "slam.weights"), ({"weights": "x", "keyframe_every": 0}, "slam.keyframe_every")],
)
def test_options_that_cannot_work_are_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        prgbd.make_slam("posenet", **options)


def test_a_depth_plugin_without_a_pose_network_is_refused(tmp_path):
    prgbd.make_depth("rt_monodepth").save_weights(tmp_path)
    with pytest.raises(ConfigError, match="brings no pose network"):
        prgbd.make_slam("posenet", depth="rt_monodepth", weights=tmp_path)
