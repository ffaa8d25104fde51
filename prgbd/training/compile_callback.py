"""A callback that compiles the depth network while Lightning runs."""

from __future__ import annotations

import contextlib
from typing import Any

import lightning
from lightning.pytorch.callbacks import Callback

from prgbd.core.computing import compiled


class Compilation(Callback):
    """Compiles the ``estimator`` of the module in every process of a training, and leaves it as it was at the end."""

    def __init__(self) -> None:
        self._stack: contextlib.ExitStack | None = None

    def setup(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, stage: str) -> None:
        """Compile: here and not before, because what is compiled cannot be sent to another process."""
        self._stack = contextlib.ExitStack()
        self._stack.enter_context(compiled(pl_module.estimator))  # type: ignore[arg-type]

    def teardown(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, stage: str) -> None:
        """Leave the network as it was."""
        self._close()

    def on_exception(self, trainer: Any, pl_module: Any, exception: BaseException) -> None:
        """Leave the network as it was."""
        self._close()

    def _close(self) -> None:
        if self._stack is not None:
            self._stack.close()
            self._stack = None
