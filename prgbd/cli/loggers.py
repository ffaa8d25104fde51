"""Loggers of trainings, by the config group ``logger``."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from prgbd.core.errors import ConfigError

PACKAGES = {"csv": None, "tensorboard": "tensorboard", "wandb": "wandb"}


def logger_maker(config: Mapping[str, Any]) -> Callable[[Path], Any] | None:
    """Return what makes a Lightning logger for the folder of a training; None where ``losses.csv`` is enough.

    Raises:
        ConfigError: If the logger is unknown or its package is missing.
    """
    options = dict(config["logger"])
    name = options.pop("name", "csv")
    if name not in PACKAGES:
        raise ConfigError(f"There is no logger '{name}'; choose one of {', '.join(PACKAGES)}.")
    package = PACKAGES[name]
    if package is None:
        return None
    if importlib.util.find_spec(package) is None:
        raise ConfigError(f"logger={name} needs the package {package}; pip install 'prgbd[{name}]'.")
    return {"tensorboard": _tensorboard, "wandb": _wandb}[name](options)


def _tensorboard(options: Mapping[str, Any]) -> Callable[[Path], Any]:
    def make(folder: Path) -> Any:
        from lightning.pytorch.loggers import TensorBoardLogger

        return TensorBoardLogger(**{"save_dir": str(folder), "name": "tensorboard", "version": "", **options})

    return make


def _wandb(options: Mapping[str, Any]) -> Callable[[Path], Any]:
    def make(folder: Path) -> Any:
        from lightning.pytorch.loggers import WandbLogger

        # The folder tells the trainings of a run apart: RUN/loops/01/training.
        name = "/".join(part for part in folder.parts[-4:] if part not in ("loops", "training"))
        return WandbLogger(**{"save_dir": str(folder), "name": name, **options})

    return make
