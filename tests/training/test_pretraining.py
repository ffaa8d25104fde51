"""Self-supervised pre-training on a wall that slides by: the loss falls, the geometry follows every augmentation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from prgbd import DepthEstimator, DepthPrediction, Frame, PinholeCamera, Sequence
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.testing.planar_scene import planar_scene
from prgbd.training.pretraining import DepthPretraining, augmented, pretrain
from prgbd.training.pretraining_data import PretrainingData, Triplets, decode, image_motion
from prgbd.training.pretraining_settings import PretrainingSettings

HEIGHT, WIDTH = 48, 64


class Wall(Sequence):
    """A camera that slides along a textured wall; ``still`` frames repeat the first one."""

    name = "wall"

    def __init__(self, frames: int = 12, still: int = 0) -> None:
        scene = planar_scene(frames, WIDTH * 2, HEIGHT * 2)
        self._images = [scene[0].image] * still + [f.image for f in scene]
        self.camera = PinholeCamera.from_fov(WIDTH * 2, HEIGHT * 2, 60.0)
        self.timestamps = np.arange(len(self._images)) * 0.1

    def frame(self, index: int) -> Frame:
        return Frame(index, float(self.timestamps[index]), self._images[index])


class OneDepth(DepthEstimator):
    """One depth for the whole image, and a pose network that knows one motion: enough to fit the wall."""

    input_size = (HEIGHT, WIDTH)
    depth_range = (0.1, 100.0)

    def __init__(self, with_pose: bool = True) -> None:
        super().__init__()
        self.log_depth = nn.Parameter(torch.tensor(0.0))
        object.__setattr__(self, "_pose", OneMotion() if with_pose else None)

    def forward(self, images):
        return DepthPrediction((self.log_depth.exp().expand(len(images), 1, *images.shape[2:]),))

    def pose_network(self):
        return self._pose


class OneMotion(nn.Module):
    """A sideways motion whose sign follows mirroring, because it is read off the images."""

    def __init__(self) -> None:
        super().__init__()
        self.speed = nn.Parameter(torch.tensor(0.0))

    def forward(self, first, second):
        forward = (second[..., 1:] - first[..., :-1]).abs().mean(dim=(1, 2, 3))
        backward = (second[..., :-1] - first[..., 1:]).abs().mean(dim=(1, 2, 3))
        pose = torch.eye(4).repeat(len(first), 1, 1)
        pose[:, 0, 3] = torch.sign(forward - backward).detach() * self.speed
        return pose


def settings(**changes) -> PretrainingSettings:
    return PretrainingSettings(**{"batch_size": 4, "epochs": 20, "learning_rate": 2e-3, "val_fraction": 0.2} | changes)


def test_the_loss_falls_and_the_motion_is_found(tmp_path) -> None:
    estimator = OneDepth()
    figures = pretrain(estimator, [Wall()], settings(), tmp_path)
    assert figures["held_out_after"] < 0.5 * figures["held_out_before"]
    # 3 pixels of 128 a frame are 1.5 of the network's: motion = pixels * depth / focal length.
    focal = Wall().camera.resized(WIDTH, HEIGHT).fx
    pixels = estimator.pose_network().speed.item() * focal / estimator.log_depth.exp().item()
    assert abs(pixels) == pytest.approx(1.5, abs=0.4)
    assert not (tmp_path / "checkpoint").exists()


def test_mirroring_moves_the_principal_point() -> None:
    K = torch.tensor([[50.0, 0, 20.0], [0, 50.0, 24.0], [0, 0, 1]]).repeat(8, 1, 1)
    images = torch.rand(8, 3, 3, HEIGHT, WIDTH)
    mirrored, seen = augmented(Triplets(images, K), torch.Generator().manual_seed(1))
    flipped = torch.tensor([torch.equal(a, b.flip(-1)) for a, b in zip(mirrored.images, images, strict=True)])
    assert 0 < flipped.sum() < 8
    assert torch.equal(mirrored.K[:, 0, 2], torch.where(flipped, WIDTH - 1 - 20.0, 20.0))
    assert torch.equal(mirrored.images[~flipped], images[~flipped])
    assert not torch.equal(seen, mirrored.images)
    assert seen.min() >= 0
    assert seen.max() <= 1


def test_the_loss_of_a_mirrored_triplet_is_the_same() -> None:
    source = decode(Wall(), OneDepth(), settings())
    K = torch.from_numpy(source.camera.K).float()
    K[0, 2] += 3.0  # where mirroring the camera matters
    plain = Triplets(torch.from_numpy(source.images[[4, 3, 5]]).float()[None] / 255, K[None])
    mirror = K.clone()
    mirror[0, 2] = WIDTH - 1 - K[0, 2]
    flipped = Triplets(plain.images.flip(-1), mirror[None])
    module = DepthPretraining(OneDepth(), OneMotion(), settings(automask=False))
    module.pose.speed.data.fill_(0.03)
    losses = [module.loss(b, b.images, None)["total"].item() for b in (plain, flipped)]
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)


def test_still_frames_are_left_out_and_counted() -> None:
    source = decode(Wall(6, still=4), OneDepth(), settings())
    assert source.still == 4  # frames 1 to 4 have a neighbour that looks the same
    assert list(source.targets) == [5, 6, 7, 8]


def test_motion_is_measured_in_grey_levels() -> None:
    images = np.zeros((3, 3, HEIGHT, WIDTH), np.uint8)
    images[2] = 10
    assert np.allclose(image_motion(images, 1), [0, 10])


def test_a_camera_that_stands_still_is_refused() -> None:
    source = decode(Wall(1, still=5), OneDepth(), settings())
    with pytest.raises(DataError, match="min_motion"):
        PretrainingData([source], settings())


def test_a_recording_shorter_than_a_triplet_is_refused() -> None:
    with pytest.raises(DataError, match="too few"):
        decode(Wall(2), OneDepth(), settings())


def test_a_network_without_pose_network_is_refused(tmp_path) -> None:
    with pytest.raises(ConfigError, match="pose network"):
        pretrain(OneDepth(with_pose=False), [Wall()], settings(), tmp_path)


@pytest.mark.parametrize("wrong", [{"epochs": 0}, {"max_steps": 0}, {"val_fraction": 0.9}, {"learning_rate": -1.0}])
def test_settings_that_cannot_work_are_refused(wrong) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        settings(**wrong)
