"""What a run needs of the machine: devices, loggers, viewers and folders, looked at before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from prgbd.cli.loggers import logger_maker
from prgbd.cli.options import RunOptions
from prgbd.core.errors import ConfigError
from prgbd.loop.viewing import viewer_maker

if TYPE_CHECKING:
    from prgbd.training.trainers import TrainerFactory


def check_machine(options: RunOptions, config: Mapping[str, Any]) -> None:
    """Look whether a run can have what it will need.

    Args:
        options: All options of the run.
        config: The same as plain data, with those of the trainer and the logger.

    Raises:
        ConfigError: If it cannot.
    """
    viewer_maker(options.viz or "none")
    cache = options.sensing.cache
    if cache is not None:
        try:
            cache.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"sensing.cache={cache} cannot be made ({error.strerror}); choose another folder."
            ) from error
    trains = options.task.name in ("self_improve", "pretrain")
    if trains or options.depth.id:
        trainer_factory(config).check(trains=trains)


def use_threads(wanted: int | None) -> int:
    """Let the network compute with so many threads of the processor.

    Args:
        wanted: How many; None leaves it to PyTorch, which takes OMP_NUM_THREADS, or every core.

    Returns:
        How many there are now.
    """
    import torch

    if wanted is not None:
        torch.set_num_threads(wanted)
    return torch.get_num_threads()


def trainer_factory(config: Mapping[str, Any]) -> TrainerFactory:
    """Return the Lightning configuration of ``trainer`` with the loggers of ``logger``.

    Raises:
        ConfigError: If the logger is unknown or its package is missing.
    """
    from prgbd.training.trainers import TrainerFactory

    return TrainerFactory(config["trainer"], make_logger=logger_maker(config))
