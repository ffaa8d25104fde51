"""The group ``trainer``: Lightning's options on the command line."""

from pathlib import Path

import pytest
from lightning import LightningModule

from prgbd.training.trainers import TrainerFactory
from tests.cli.conftest import FAKES
from tests.loop.fakes import Tiny
from tests.training.spies import Counting, FakeGpuOnCpu

TWO_LOOPS = ("task.max_loops=2", "task.min_improvement=null")
COUNTING = "+trainer.callbacks=[{_target_: tests.training.spies.Counting}]"


@pytest.fixture(autouse=True)
def _count_from_zero(monkeypatch):
    monkeypatch.setattr(Counting, "trainings", 0)


def test_callbacks_and_loggers_run_in_every_loop(run):
    run(*TWO_LOOPS, COUNTING, "+trainer.logger=true")
    assert Counting.trainings == 2
    for loop in ("00", "01"):
        metrics = Path(f"run/loops/{loop}/training/lightning_logs/version_0/metrics.csv")
        assert "held_out/total" in metrics.read_text().splitlines()[0]


def test_callbacks_and_loggers_run_in_pretraining(run):
    network = (FAKES[0], "+depth=test/pose", FAKES[2])
    run("task=pretrain", "pretraining.epochs=1", COUNTING, "+trainer.logger=true", fakes=network)
    assert Counting.trainings == 1
    assert Path("run/training/lightning_logs/version_0/metrics.csv").is_file()


@pytest.mark.parametrize(
    "wrong",
    [
        "+trainer.callbacks=[{_target_: tests.training.spies.Countin}]",
        "+trainer.callbacks=[{_target_: tests.training.spies.Counting, stp: 2}]",
        "+trainer.logger={_target_: lightning.pytorch.loggers.NoLogger}",
    ],
)
def test_what_cannot_be_made_is_said_before_anything_is_computed(cli, wrong):
    answer = cli(*FAKES, "out=run", wrong)
    assert answer.code == 2
    assert wrong.partition("=")[0].lstrip("+") in answer.sentence
    assert not Path("run").exists()


def test_every_step_computes_on_the_trainer_s_device(run, monkeypatch):
    """A training leaves the network on the CPU; what comes after must not compute there."""
    gpu, computed_there, plain = FakeGpuOnCpu(), [], Tiny.forward

    def forward(self, images):
        computed_there.append(gpu.in_use)
        return plain(self, images)

    def leave(self):
        gpu.in_use = False
        return self

    def with_gpu(config):
        return TrainerFactory({**config["trainer"], "accelerator": gpu})

    monkeypatch.setattr(Tiny, "forward", forward)
    monkeypatch.setattr(LightningModule, "cpu", leave)
    monkeypatch.setattr("prgbd.cli.job.trainer_factory", with_gpu)
    run(*TWO_LOOPS)
    assert len(computed_there) > 30
    assert all(computed_there)
