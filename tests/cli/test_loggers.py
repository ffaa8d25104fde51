"""Loggers chosen by the config group ``logger``."""

import importlib.util
import sys
from types import ModuleType

import pytest

from prgbd.cli.loggers import logger_maker
from prgbd.core.errors import ConfigError


def test_csv_needs_no_logger_of_lightning():
    assert logger_maker({"logger": {"name": "csv"}}) is None


def test_an_unknown_logger_is_named_with_the_known_ones():
    with pytest.raises(ConfigError, match=r"'clearml'; choose one of csv, tensorboard, wandb"):
        logger_maker({"logger": {"name": "clearml"}})


@pytest.mark.parametrize("name", ["tensorboard", "wandb"])
def test_a_missing_package_is_named_with_its_extra(monkeypatch, name):
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: None)
    with pytest.raises(ConfigError, match=rf"logger={name} .*pip install 'prgbd\[{name}\]'"):
        logger_maker({"logger": {"name": name}})


def test_wandb_gets_its_options_and_a_name_that_tells_the_loops_apart(monkeypatch, tmp_path):
    seen = {}
    module = ModuleType("lightning.pytorch.loggers")
    module.WandbLogger = lambda **options: seen.update(options)
    monkeypatch.setitem(sys.modules, "lightning.pytorch.loggers", module)
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: object())
    make = logger_maker({"logger": {"name": "wandb", "project": "prgbd", "offline": True}})
    folder = tmp_path / "run" / "loops" / "01" / "training"
    make(folder)
    assert seen == {"save_dir": str(folder), "name": "run/01", "project": "prgbd", "offline": True}
