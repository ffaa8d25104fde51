"""Pre-training as a run: order of the pose network's pairs, cameras, schedule, logging, and going on after a kill."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.loggers import CSVLogger
from torch import nn

from prgbd.core.depth import DepthEstimator
from prgbd.core.types import DepthPrediction
from prgbd.functional.warping import transformation_from_parameters
from prgbd.training.pretraining import DepthPretraining, pretrain
from prgbd.training.pretraining_data import PretrainingData, Triplets, decode
from prgbd.training.pretraining_settings import PretrainingSettings
from prgbd.training.sampling import EpochSampler
from prgbd.training.trainers import TrainerFactory

from .scenes import WallSequence

QUICK = PretrainingSettings(
    epochs=6, batch_size=4, learning_rate=1e-2, lr_step_epoch=5, augment=False, min_motion=0.0, val_fraction=0.2
)
QUIET = TrainerFactory({"enable_progress_bar": False})


class ConstantMotion(nn.Module):
    """One motion for all pairs, which is right for a camera of constant velocity; remembers what it was asked."""

    def __init__(self):
        super().__init__()
        self.motion = nn.Parameter(torch.tensor([0.0, 0.0, 0.0, -0.04, 0.0, 0.0]))
        self.pairs = []

    def forward(self, first, second):
        self.pairs.append((first.detach().clone(), second.detach().clone()))
        motion = self.motion.expand(len(first), 6)
        return transformation_from_parameters(motion[:, :3], motion[:, 3:])


class PlaneNet(DepthEstimator):
    """A plane of inverse depth over the image."""

    input_size = (32, 48)
    depth_range = (0.5, 50.0)

    def __init__(self):
        super().__init__()
        self.plane = nn.Parameter(torch.tensor([0.0, 0.0, 0.2]))
        object.__setattr__(self, "pose", ConstantMotion())

    def pose_network(self):
        return self.pose

    def forward(self, images):
        height, width = images.shape[-2:]
        y = torch.linspace(-1, 1, height)[:, None].expand(height, width)
        x = torch.linspace(-1, 1, width)[None].expand(height, width)
        inverse = torch.einsum("c,chw->hw", self.plane, torch.stack([x, y, torch.ones_like(x)])).clamp(min=0.02)
        return DepthPrediction(((1 / inverse).expand(len(images), 1, height, width),))


def test_learns_a_tilted_wall_and_the_motion_from_images_alone(tmp_path):
    network, sequence = PlaneNet(), WallSequence(16, step=0.12)
    figures = pretrain(network, [sequence], replace(QUICK, epochs=30, lr_step_epoch=25), tmp_path, QUIET)
    assert figures["train_samples"] + figures["held_out_samples"] == 14
    assert figures["steps"] == 30 * (figures["train_samples"] // 4)
    # The camera moves right, so a point of the first camera lies further left in the second.
    assert network.pose.motion[3] < -0.03
    true, predicted = sequence.depth(8), network.predict(sequence.frame(8).image)
    scale = np.median(true) / np.median(predicted)
    assert np.mean(np.abs(scale * predicted - true) / true) < 0.05


def test_pose_network_sees_pairs_in_temporal_order():
    network = PlaneNet()
    images = torch.rand(2, 3, 3, 32, 48)
    target, earlier, later = images.unbind(1)
    batch = Triplets(images, torch.tensor(WallSequence().camera.resized(48, 32).K).float().expand(2, 3, 3))
    DepthPretraining(network, network.pose, QUICK).loss(batch, images, None)
    (a, b), (c, d) = network.pose.pairs
    for seen, expected in ((a, earlier), (b, target), (c, target), (d, later)):
        torch.testing.assert_close(seen, expected)


def test_every_recording_keeps_its_own_camera():
    wide, narrow = WallSequence(6, width=96, height=64), WallSequence(6, width=80, height=64, name="narrow")
    settings = replace(QUICK, val_fraction=0.0, batch_size=8)
    data = PretrainingData([decode(s, PlaneNet(), settings) for s in (wide, narrow)], settings)
    (batch,) = list(data.val_dataloader())
    expected = [s.camera.resized(48, 32).K for s in (wide, narrow) for _ in range(4)]
    np.testing.assert_allclose(batch.K, expected, rtol=1e-6)
    assert batch.images.dtype == torch.uint8


def test_frame_gap_widens_the_triplet():
    settings = replace(QUICK, frame_gap=3, val_fraction=0.0)
    source = decode(WallSequence(9), PlaneNet(), settings)
    assert source.targets.tolist() == [3, 4, 5]
    batch = next(iter(PretrainingData([source], settings).val_dataloader()))
    assert torch.equal(batch.images[0], torch.from_numpy(source.images[[3, 0, 6]]))


def test_learning_rate_steps_down_and_losses_are_logged(tmp_path):
    rates = []

    class Watch(Callback):
        def on_train_epoch_start(self, trainer, module):
            rates.append(trainer.optimizers[0].param_groups[0]["lr"])

    settings = replace(QUICK, epochs=4, lr_step_epoch=2)
    logger = CSVLogger(tmp_path, name="", version="")
    trainer = QUIET.extended(Watch(), log_every_n_steps=1, logger=logger)
    pretrain(PlaneNet(), [WallSequence(12)], settings, tmp_path / "run", trainer)
    np.testing.assert_allclose(rates, [1e-2, 1e-2, 1e-3, 1e-3])
    logger.save()
    header = (tmp_path / "metrics.csv").read_text().splitlines()[0].split(",")
    assert {"train/total", "train/photometric", "train/smoothness", "held_out/total"} <= set(header)


class Kill(Callback):
    """Ends a training as a kill would, at a step or where an epoch begins."""

    def __init__(self, epoch=None, step=None):
        self.epoch, self.step = epoch, step

    def on_train_epoch_start(self, trainer, module):
        if trainer.current_epoch == self.epoch:
            raise RuntimeError("killed")

    def on_train_batch_start(self, trainer, module, batch, batch_idx):
        if trainer.global_step == self.step:
            raise RuntimeError("killed")


class Noisy(PlaneNet):
    """Has all that a checkpoint must carry or an epoch must draw anew: statistics of batches, and dropout."""

    def __init__(self):
        super().__init__()
        self.norm = nn.BatchNorm2d(3)
        self.dropout = nn.Dropout(0.1)

    def forward(self, images):
        prediction = super().forward(images)
        factor = 1 + 0.1 * self.dropout(self.norm(images)).mean(1, keepdim=True)
        return DepthPrediction(tuple(depth * factor for depth in prediction.depths))


def weights_of(network):
    return {**network.state_dict(), "motion": network.pose.motion.detach()}


def same(first, second):
    return all(torch.equal(value, second[name]) for name, value in first.items())


def test_killed_training_ends_as_if_it_had_not_been(tmp_path):
    sequence = WallSequence(14)
    settings = replace(QUICK, epochs=4, lr_step_epoch=2, augment=True)

    def train(folder, *callbacks, **changes):
        network = Noisy()
        trainer = QUIET.extended(*callbacks)
        return network, pretrain(network, [sequence], replace(settings, **changes), tmp_path / folder, trainer)

    whole, expected = train("whole")
    steps = expected["steps"] // 4
    assert steps >= 2
    assert not same(weights_of(whole), weights_of(train("other", seed=1)[0]))
    # At the first batch, before and after the learning rate falls, and in the midst of an epoch.
    for number, kills in enumerate(([Kill(step=0)], [Kill(epoch=1), Kill(epoch=2)], [Kill(step=3 * steps + 1)])):
        for kill in kills:
            with pytest.raises(RuntimeError, match="killed"):
                train(f"killed{number}", kill)
        network, figures = train(f"killed{number}")
        assert same(weights_of(whole), weights_of(network)), number
        assert {**figures, "seconds": 0} == {**expected, "seconds": 0}
        assert not (tmp_path / f"killed{number}" / "checkpoint").exists()


def test_killed_after_the_last_step_in_the_midst_of_an_epoch(tmp_path):
    class KillAtEnd(Callback):
        def on_train_end(self, trainer, module):
            raise RuntimeError("killed")

    def train(folder, *callbacks):
        network = Noisy()
        settings = replace(QUICK, max_steps=5, augment=True)
        return network, pretrain(network, [WallSequence(14)], settings, tmp_path / folder, QUIET.extended(*callbacks))

    whole, expected = train("whole")
    assert expected["steps"] == 5
    with pytest.raises(RuntimeError, match="killed"):
        train("killed", KillAtEnd())
    network, figures = train("killed")
    assert same(weights_of(whole), weights_of(network))
    assert {**figures, "seconds": 0} == {**expected, "seconds": 0}


def test_killed_training_does_not_repeat_finished_epochs(tmp_path):
    epochs = []

    class Count(Callback):
        def on_train_epoch_start(self, trainer, module):
            epochs.append(trainer.current_epoch)

    with pytest.raises(RuntimeError, match="killed"):
        pretrain(PlaneNet(), [WallSequence(12)], QUICK, tmp_path, QUIET.extended(Kill(epoch=3)))
    pretrain(PlaneNet(), [WallSequence(12)], QUICK, tmp_path, QUIET.extended(Count()))
    assert epochs == [3, 4, 5]


def test_every_epoch_shuffles_by_its_number_alone():
    sampler, other = EpochSampler(20, seed=4), EpochSampler(20, seed=4)
    orders = []
    for epoch in (0, 1, 2):
        sampler.set_epoch(epoch)
        orders.append(list(sampler))
    other.set_epoch(2)
    assert list(other) == list(sampler) == orders[2]
    assert sorted(orders[0]) == list(range(20))
    assert orders[0] != orders[1] != orders[2]


def test_images_beyond_the_memory_lie_in_a_file_that_goes(tmp_path):
    seen = []

    class Look(Callback):
        def on_train_start(self, trainer, module):
            seen.extend(sorted(path.name for path in (tmp_path / "images").glob("*")))

    sequences, settings = [WallSequence(10), WallSequence(8, name="second")], replace(QUICK, epochs=2)
    networks = [PlaneNet(), PlaneNet()]
    pretrain(networks[0], sequences, settings, tmp_path, QUIET.extended(Look()))
    assert seen == []
    pretrain(networks[1], sequences, replace(settings, memory_mb=0), tmp_path, QUIET.extended(Look()))
    assert seen == ["0.npy", "1.npy"]
    assert not (tmp_path / "images").exists()
    assert same(weights_of(networks[0]), weights_of(networks[1]))


def test_global_random_state_is_left_alone(tmp_path):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    pretrain(PlaneNet(), [WallSequence(10)], replace(QUICK, epochs=1, augment=True), tmp_path, QUIET)
    assert torch.equal(torch.rand(4), expected)
