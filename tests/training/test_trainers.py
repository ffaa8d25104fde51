"""One Lightning configuration for trainings and predictions."""

import pytest
import torch
from lightning.pytorch.callbacks import Callback, EarlyStopping
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.plugins import MixedPrecision

from prgbd.core.errors import ConfigError
from prgbd.training.trainers import TrainerFactory
from tests.training.spies import Counting, FakeGpu

EARLY = {"_target_": "lightning.pytorch.callbacks.EarlyStopping", "monitor": "held_out/total"}
SILENT = {"enable_progress_bar": False}


def pair(tmp_path, options=None, *callbacks, own=(), **more):
    return TrainerFactory({**SILENT, **(options or {})}, callbacks, **more).pair(tmp_path, {"max_epochs": 3}, own)


def kinds(trainer):
    return [type(callback) for callback in trainer.callbacks]


@pytest.mark.parametrize(
    ("devices", "one"),
    [([3], [3]), ([2, 3], [2]), ("1,2", [1]), ("2,", [2]), (2, 1), ("2", 1), ("auto", 1), (-1, 1), ("x", "x")],
)
def test_one_process_takes_the_first_device_that_is_named(devices, one):
    assert TrainerFactory({"devices": devices}).one_device == one


def test_the_network_predicts_where_it_is_trained_and_measured(tmp_path):
    factory = TrainerFactory({"accelerator": FakeGpu(), "devices": [3], **SILENT})
    trainer, gauge = factory.pair(tmp_path, {}, [])
    third = torch.device("cuda", 3)
    assert factory.fabric.device == trainer.strategy.root_device == gauge.strategy.root_device == third


def test_a_measurement_of_several_processes_is_made_by_one_without_the_user_s_callbacks(tmp_path):
    trainer, gauge = pair(tmp_path, {"strategy": "ddp_spawn", "devices": 2}, Counting())
    assert (trainer.world_size, gauge.world_size) == (2, 1)
    assert Counting in kinds(trainer)
    assert Counting not in kinds(gauge)


def test_precision_and_its_plugin_reach_trainings_and_predictions(tmp_path):
    for options in ({"precision": "bf16-mixed"}, {"plugins": [MixedPrecision("bf16-mixed", "cpu")]}):
        trainer, gauge = pair(tmp_path, options)
        assert trainer.precision == gauge.precision == "bf16-mixed"
        with TrainerFactory(options).fabric.autocast():
            assert torch.is_autocast_enabled("cpu")


def test_options_of_the_user_come_before_the_training_s(tmp_path):
    trainer, _ = pair(tmp_path, {"max_epochs": 7})
    assert trainer.max_epochs == 7
    assert pair(tmp_path)[0].max_epochs == 3


def test_described_callbacks_are_made_anew_for_every_training_and_objects_are_kept(tmp_path):
    mine = Counting()
    factory = TrainerFactory({**SILENT, "callbacks": [EARLY, mine]})
    first, second = (factory.pair(tmp_path, {}, [])[0] for _ in range(2))
    early = [next(c for c in trainer.callbacks if isinstance(c, EarlyStopping)) for trainer in (first, second)]
    assert early[0] is not early[1]
    assert all(mine in trainer.callbacks for trainer in (first, second))


@pytest.mark.parametrize("callbacks", [EARLY, [EARLY], {"early": EARLY, "none": None}])
def test_callbacks_may_be_one_a_list_or_named(tmp_path, callbacks):
    assert EarlyStopping in kinds(pair(tmp_path, {"callbacks": callbacks})[0])


def test_lightning_s_own_logger_writes_into_the_training_s_folder(tmp_path):
    trainer, gauge = pair(tmp_path, {"logger": True})
    assert isinstance(trainer.logger, CSVLogger)
    assert trainer.logger is gauge.logger
    assert trainer.logger.log_dir.startswith(str(tmp_path))
    assert pair(tmp_path)[0].loggers == []


def test_a_described_logger_joins_that_of_the_run(tmp_path):
    described = {"_target_": "lightning.pytorch.loggers.CSVLogger", "name": "mine"}
    trainer, _ = pair(tmp_path, {"logger": described}, make_logger=lambda folder: CSVLogger(folder, name="run"))
    assert [logger.name for logger in trainer.loggers] == ["run", "mine"]
    assert trainer.loggers[1].save_dir == str(tmp_path)
    elsewhere, _ = pair(tmp_path, {"logger": [{**described, "save_dir": "elsewhere"}]})
    assert elsewhere.logger.save_dir == "elsewhere"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"callbacks": [{"_target_": "lightning.EarlyStoping"}]}, ["no class 'lightning.EarlyStoping'", "callbacks"]),
        ({"callbacks": {"_target_": "no_such_package.Callback"}}, ["'no_such_package.Callback'", "installed"]),
        ({"callbacks": [{**EARLY, "patienc": 1}]}, ["EarlyStopping", "trainer.callbacks", "'patienc'"]),
        ({"callbacks": [{"_target_": 3}]}, ["'3'", "trainer.callbacks"]),
        ({"callbacks": ["EarlyStopping"]}, ["'EarlyStopping'", "no Callback", "_target_"]),
        ({"logger": "csv"}, ["'csv'", "no Logger"]),
        ({"logger": {"_target_": "collections.Counter"}}, ["Counter()", "no Logger"]),
        ({"plugins": [{"_target_": "no_such_package.Plugin"}]}, ["trainer.plugins"]),
        ({"devices": "x"}, ["trainer.*", "devices"]),
        ({"max_steps_": 1}, ["trainer.*", "max_steps_"]),
        ({"accelerator": "gpu"}, ["trainer=gpu", "trainer=cpu"]),
        ({"enable_checkpointing": False}, ["trainer.*", "enable_checkpointing"]),
    ],
    ids=lambda value: "" if isinstance(value, list) else str(value),
)
def test_what_cannot_be_is_said_in_one_sentence(options, words, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError) as caught:
        TrainerFactory(options).check()
    sentence = str(caught.value)
    assert "\n" not in sentence
    for word in words:
        assert word in sentence


def test_own_callbacks_stand_beside_the_user_s(tmp_path):
    class Own(Callback):
        pass

    assert {Own, Counting} <= set(kinds(pair(tmp_path, {"callbacks": [Counting()]}, own=[Own()])[0]))
