"""The folder that Hydra makes for a run, and takes back if the run does not start."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any, ClassVar

from hydra.experimental.callback import Callback
from omegaconf import DictConfig


class RunFolder(Callback):
    """Hydra callback: remembers which folders are not there before a run, as only those may be taken back."""

    made: ClassVar[list[Path]] = []

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note the folders that will be made, the innermost first."""
        folder = Path(str(config.hydra.run.dir)).absolute()
        RunFolder.made[:] = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]

    @classmethod
    def take_back(cls) -> None:
        """Remove those of the folders that are empty."""
        with contextlib.suppress(OSError):  # ends as soon as something lies in one
            for path in cls.made:
                if path.is_dir():
                    path.rmdir()
        cls.made.clear()
