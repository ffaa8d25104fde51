"""``task=pretrain``: how the weights are stored, and runs that were stopped."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from prgbd import register_depth
from prgbd.cli.task_options import PretrainTask
from prgbd.cli.tasks.pretrain import weight_options
from prgbd.core.errors import ConfigError
from prgbd.loop.refining import TrainingProgress
from prgbd.plugins.depth.monodepth2 import Monodepth2
from tests.cli.test_config import composed
from tests.cli.test_tasks import without_times
from tests.loop.fakes import Tiny, TinyWithPose

POSE = ("depth=test/pose", "data=test/wall")
HALVING = ("depth=test/halving", "data=test/wall")
QUICK = ("task=pretrain", "pretraining.epochs=2", "pretraining.learning_rate=1e-2", "data.frames=20")


class Halving(TinyWithPose):
    """Stores half precision on request."""

    def save_weights(self, folder, *, half=False):
        folder.mkdir(parents=True, exist_ok=True)
        state = {name: value.half() if half else value for name, value in self.state_dict().items()}
        torch.save(state, folder / self.weights_file)


@pytest.fixture(autouse=True)
def _halving():
    register_depth("test/halving", f"{__name__}:Halving", override=True)


def test_weights_are_stored_in_half_precision_and_evaluated_as_stored(run, cli):
    summary = run(*QUICK, "task.half=true", fakes=HALVING)
    state = torch.load("run/weights/model.pth")
    assert {value.dtype for value in state.values()} == {torch.float16}
    answer = cli(*HALVING, "task=evaluate", "depth.weights=run/weights", "data.frames=20", "out=again")
    assert answer.code == 0, answer.err
    again = json.loads(Path("again/summary.json").read_text())
    assert again["loops"][0]["depth"] == summary["loops"][0]["depth"]


def test_stopped_in_training_and_resumed_ends_as_if_it_had_not_been(cli, monkeypatch):
    count = TrainingProgress.on_train_batch_end
    stops = iter([True])

    def stopping(self, trainer, *rest):
        if trainer.current_epoch == 1 and next(stops, False):
            raise KeyboardInterrupt
        count(self, trainer, *rest)

    monkeypatch.setattr(TrainingProgress, "on_train_batch_end", stopping)
    assert cli(*POSE, *QUICK, "out=stopped").code != 0
    assert Path("stopped/training/checkpoint/last.ckpt").is_file()
    assert cli("resume=stopped").code == 0
    assert cli(*POSE, *QUICK, "out=whole").code == 0
    summaries = [json.loads(Path(f"{run}/summary.json").read_text()) for run in ("stopped", "whole")]
    assert without_times(summaries[0]) == without_times(summaries[1])
    weights = [Path(f"{run}/weights/model.pth").read_bytes() for run in ("stopped", "whole")]
    assert weights[0] == weights[1]


@pytest.mark.parametrize("option", ["half=true", "pose=false"])
def test_a_network_that_cannot_store_so_is_refused_before_training(cli, option):
    answer = cli(*POSE, *QUICK, f"task.{option}", "out=refused")
    assert answer.code != 0
    assert f"task.{option}" in answer.sentence
    assert not Path("refused/training").exists()


def test_a_flag_is_true_or_false(cli):
    assert "task.half" in cli(*POSE, *QUICK, "task.half=maybe", "out=refused").sentence


def test_only_what_differs_from_the_default_reaches_save_weights():
    monodepth2 = object.__new__(Monodepth2)
    assert weight_options(PretrainTask(), Tiny()) == {}
    assert weight_options(PretrainTask(half=True, pose=False), monodepth2) == {"half": True, "pose": False}
    with pytest.raises(ConfigError, match=r"Tiny cannot .*task\.pose=false"):
        weight_options(PretrainTask(pose=False), Tiny())


def test_demo_weights_learn_from_neither_the_demo_nor_the_test():
    recipe, demo = (composed(f"experiment={name}") for name in ("demo_weights", "demo"))
    learnt = set(recipe["data"]["sequences"])
    assert len(learnt) == 11
    assert not learnt & {*recipe["data"]["test_sequences"], *demo["data"]["sequences"]}
    assert recipe["task"] == {"name": "pretrain", "half": True, "pose": False}
    assert recipe["depth"]["weights"] is None
