"""A refinement that is killed anywhere goes on there, and ends with the same bytes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from lightning.pytorch.callbacks import Callback
from torch import nn

from prgbd.core.types import DepthPrediction
from prgbd.training.refinement import refine
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.trainers import TrainerFactory

from .scenes import WallSequence, true_slam_result
from .test_refinement import TiltNet

QUICK = RefinementSettings(
    learning_rate=5e-3, epochs=3, batch_size=1, val_fraction=0.25, augment=True, checkpoint_minutes=0.0
)
STEPS = 5  # per epoch: 7 samples, 2 of them held out


class Noisy(TiltNet):
    """Draws from the global generator as well."""

    def __init__(self):
        super().__init__()
        self.dropout = nn.Dropout(0.2)

    def forward(self, images):
        scale = 1 + 0.1 * self.dropout(torch.ones(1, device=images.device))
        return DepthPrediction(tuple(depth * scale for depth in super().forward(images).depths))


class Kill(Callback):
    """Ends a training as a kill would, in the midst of a step, or in the held-out pass of an epoch."""

    def __init__(self, step: int, hook: str = "on_after_backward") -> None:
        self.step = step
        setattr(self, hook, self.kill)
        self.seen: list[int] = []

    def kill(self, trainer, *args):
        if trainer.global_step == self.step:
            raise RuntimeError("killed")

    def on_train_batch_start(self, trainer, module, batch, batch_idx):
        self.seen.append(trainer.global_step)


@pytest.fixture(scope="module")
def wall():
    sequence = WallSequence(27, step=0.12)
    return sequence, true_slam_result(sequence)


def trained(wall, folder, settings=QUICK, *callbacks, **trainer):
    network = Noisy()
    outcome = refine(network, [wall], settings, folder, TrainerFactory(trainer, callbacks))
    return network.state_dict(), outcome


def assert_same(first, second):
    for name, value in first[0].items():
        assert torch.equal(value, second[0][name]), name
    assert first[1].losses == second[1].losses
    assert first[1].held_out_before == second[1].held_out_before
    assert first[1].held_out_after == second[1].held_out_after


@pytest.mark.parametrize("workers", [0, 1])
def test_killed_anywhere_it_goes_on_at_that_step(wall, tmp_path, workers):
    settings = replace(QUICK, workers=workers)
    whole = trained(wall, tmp_path / "whole", settings)
    steps = [row["step"] for row in whole[1].losses if row["split"] == "train"]
    assert steps == list(range(1, 3 * STEPS + 1))
    folder = tmp_path / "killed"
    kills = [Kill(0), Kill(3), Kill(STEPS, "on_validation_batch_start"), Kill(STEPS + 1), Kill(2 * STEPS)]
    for kill in kills if workers == 0 else kills[3:4]:
        with pytest.raises(RuntimeError, match="killed"):
            trained(wall, folder, settings, kill)
    last = Kill(-1)
    assert_same(trained(wall, folder, settings, last), whole)
    assert last.seen[0] == (2 * STEPS if workers == 0 else STEPS + 1)
    assert not (folder / "checkpoint").exists()


def test_accumulated_gradients_are_not_lost(wall, tmp_path):
    options = {"accumulate_grad_batches": 2, "gradient_clip_val": 1.0}
    whole = trained(wall, tmp_path / "whole", QUICK, **options)
    rows = [row for row in whole[1].losses if row["split"] == "train"]
    assert len(rows) == 3 * STEPS
    assert rows[-1]["step"] == 3 * 3
    with pytest.raises(RuntimeError, match="killed"):
        trained(wall, tmp_path / "killed", QUICK, Kill(4, "on_before_zero_grad"), **options)
    assert_same(trained(wall, tmp_path / "killed", QUICK, **options), whole)


def test_half_precision_goes_on_too(wall, tmp_path):
    options = {"precision": "bf16-mixed"}
    whole = trained(wall, tmp_path / "whole", QUICK, **options)
    with pytest.raises(RuntimeError, match="killed"):
        trained(wall, tmp_path / "killed", QUICK, Kill(STEPS + 2), **options)
    assert_same(trained(wall, tmp_path / "killed", QUICK, **options), whole)


@pytest.mark.parametrize("change", [{"learning_rate": 1e-3}, {"seed": 1}, "damaged"])
def test_a_checkpoint_of_something_else_is_not_gone_on_from(wall, tmp_path, change):
    with pytest.raises(RuntimeError, match="killed"):
        trained(wall, tmp_path / "killed", QUICK, Kill(4))
    checkpoint = tmp_path / "killed" / "checkpoint" / "last.ckpt"
    assert checkpoint.is_file()
    settings = QUICK
    if change == "damaged":
        checkpoint.write_bytes(checkpoint.read_bytes()[:1000])
    else:
        settings = replace(QUICK, **change)
    begun = Kill(-1)
    again = trained(wall, tmp_path / "killed", settings, begun)
    assert begun.seen[0] == 0
    assert_same(again, trained(wall, tmp_path / "whole", settings))


def test_checkpoints_come_as_often_as_asked_for(wall, tmp_path):
    class Look(Callback):
        def __init__(self):
            self.there = []

        def on_train_batch_start(self, trainer, module, batch, batch_idx):
            self.there.append((tmp_path / "rare" / "checkpoint" / "last.ckpt").exists())

    look = Look()
    trained(wall, tmp_path / "rare", replace(QUICK, checkpoint_minutes=60.0), look)
    assert not any(look.there)
