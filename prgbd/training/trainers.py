"""``TrainerFactory``: one Lightning configuration for whatever a run trains and predicts."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from collections.abc import Sequence as Many
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.fabric import Fabric
from lightning.fabric.strategies import SingleDeviceStrategy
from lightning.pytorch.callbacks import Callback, Checkpoint, RichProgressBar
from lightning.pytorch.loggers import CSVLogger, Logger
from lightning.pytorch.utilities.exceptions import MisconfigurationException

from prgbd.core.errors import ConfigError
from prgbd.training.compile_callback import Compilation
from prgbd.training.instantiation import all_of, listed, made
from prgbd.training.quiet import quiet_lightning

_EVERYWHERE: dict[str, Any] = {
    "accelerator": "cpu",
    "devices": 1,
    "num_sanity_val_steps": 0,
    "enable_model_summary": False,
    "use_distributed_sampler": False,  # the samplers share out the samples themselves
}
_OBJECTS = ("accelerator", "strategy", "profiler")  # beside callbacks, loggers and plug-ins, which may be several
_SEVERAL_PROCESSES = ("strategy", "num_nodes")


@dataclass(frozen=True)
class TrainerFactory:
    """Makes the trainers of a run, and the Fabric that its network predicts with, from one configuration.

    Callbacks, loggers, plug-ins, a strategy, an accelerator and a profiler may be objects, or mappings with
    ``_target_`` that ``hydra.utils.instantiate`` makes them from. What is described so is made anew for every training;
    an object is the same in all of them.

    Attributes:
        options: Options of ``lightning.Trainer``. ``logger: true`` is Lightning's CSV logger in the training's folder;
            a described logger that takes a ``save_dir`` gets that folder unless it names one.
        callbacks: Further callbacks of every training.
        make_logger: Makes a further logger, or several, for the folder of a training.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    callbacks: Many[Callback] = ()
    make_logger: Callable[[Path], Any] | None = None

    def extended(self, *callbacks: Callback, **options: Any) -> TrainerFactory:
        """Return the same configuration with further callbacks and other options."""
        return replace(self, options={**self.options, **options}, callbacks=(*self.callbacks, *callbacks))

    def pair(
        self,
        out: Path,
        defaults: Mapping[str, Any],
        callbacks: Many[Callback],
        *,
        measuring: Many[Callback] = (),
        compiled: bool = False,
    ) -> tuple[lightning.Trainer, lightning.Trainer]:
        """Make the trainer of a training, and one that measures the held-out loss before and after it.

        The second works in one process, since several would all measure the same, and without the user's callbacks.

        Args:
            out: Folder of the training.
            defaults: Options that hold unless the user gives them.
            callbacks: The training's own callbacks, beside the user's.
            measuring: The callbacks of the measurement.
            compiled: Whether the network is compiled by ``torch.compile``.

        Raises:
            ConfigError: If a callback, logger or plug-in cannot be made, or Lightning refuses an option.
        """
        # The two share their loggers: to some, every new one is a new experiment.
        shared = {**defaults, "default_root_dir": out, "logger": self._loggers(out) or False}
        several = [*self._callbacks(), *callbacks]
        if compiled:
            several, measuring = [*several, Compilation()], [*measuring, Compilation()]
        if self.bar:
            several.append(RichProgressBar(leave=False))
        with self._in_one_sentence():
            fit = {**shared, **self._plain(), "callbacks": several, "enable_progress_bar": self.bar}
            measure = {**shared, **self._alone(), "callbacks": list(measuring)}
            return lightning.Trainer(**fit), lightning.Trainer(**measure)

    @property
    def bar(self) -> bool:
        """Whether a training draws a progress bar of its own."""
        return bool(self.options.get("enable_progress_bar", sys.stderr.isatty()))

    @cached_property
    def fabric(self) -> Fabric:
        """What the network predicts with: the same accelerator and precision, on the first of the same devices.

        Raises:
            ConfigError: If Lightning refuses an option.
        """
        with self._in_one_sentence(), quiet_lightning():
            # A trainer knows more accelerators than Fabric does, so it is one that says what the options mean.
            trainer = lightning.Trainer(**self._alone(), logger=False)
            return Fabric(
                accelerator=trainer.accelerator,
                devices=self.one_device,
                strategy=SingleDeviceStrategy(trainer.strategy.root_device),
                plugins=[trainer.precision_plugin],
            )

    @property
    def one_device(self) -> Any:
        """The option ``devices`` for one process: the first device where they are named, else their number, one."""
        devices = self.options.get("devices", 1)
        if isinstance(devices, str) and "," in devices:
            devices = devices.split(",")
        if isinstance(devices, list | tuple):
            return [int(device) if isinstance(device, str) else device for device in devices[:1]]
        return devices if devices not in (-1, "-1", "auto") and not str(devices).isdecimal() else 1

    def check(self, *, trains: bool = True) -> None:
        """Let Lightning look at the options before anything is computed with them.

        Args:
            trains: Whether there will be a training, and not predictions alone.

        Raises:
            ConfigError: If they cannot work.
        """
        _ = self.fabric
        if trains:
            with quiet_lightning():
                silent = self.extended(enable_progress_bar=False)
                silent.pair(Path(tempfile.gettempdir()), {}, [Checkpoint()])

    def _plain(self) -> dict[str, Any]:
        """Return the options without callbacks and loggers, with the objects that they describe."""
        options = _EVERYWHERE | {k: v for k, v in self.options.items() if k not in ("callbacks", "logger")}
        objects = {name: made(name, options[name]) for name in _OBJECTS if name in options}
        if options.get("plugins") is not None:
            objects["plugins"] = [made("plugins", plugin) for plugin in listed(options["plugins"])]
        return options | objects

    def _alone(self) -> dict[str, Any]:
        """Return them for one process."""
        options = {k: v for k, v in self._plain().items() if k not in _SEVERAL_PROCESSES}
        return options | {"devices": self.one_device, "enable_progress_bar": False}

    def _callbacks(self) -> list[Callback]:
        described = [made("callbacks", value) for value in listed(self.options.get("callbacks"))]
        return all_of(Callback, "callbacks", [*described, *self.callbacks])

    def _loggers(self, out: Path) -> list[Logger]:
        given = self.options.get("logger")
        described = [CSVLogger(out)] if given is True else [made("logger", value, out) for value in listed(given)]
        further = listed(self.make_logger(out)) if self.make_logger is not None else []
        return all_of(Logger, "logger", [*further, *described])

    @contextmanager
    def _in_one_sentence(self) -> Iterator[None]:
        """Turn what Lightning has against an option into a ``ConfigError``."""
        try:
            yield
        except (TypeError, ValueError, RuntimeError, MisconfigurationException) as error:
            if self.options.get("accelerator") in ("gpu", "cuda") and not torch.cuda.is_available():
                raise ConfigError("trainer=gpu needs a CUDA device and PyTorch sees none; use trainer=cpu.") from error
            reason = " ".join(str(error).split())
            raise ConfigError(f"Lightning does not take the options trainer.*: {reason.rstrip('.')}.") from error
