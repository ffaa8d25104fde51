"""``RunStore``: what a run has finished, where it lies, and how it goes on after it was stopped."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

from omegaconf import OmegaConf

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.files import atomic_path, read_json, to_plain, write_json

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows: runs there are not protected against a second process
    fcntl = None  # type: ignore[assignment]

CONFIG = "config.yaml"
SUMMARY = "summary.json"
DONE = "done"


class RunStore:
    """The folder of one run.

    A step is a name with slashes, such as ``loops/00/slam/street``. ``step`` runs a function unless the step is done
    and remembers what it returned. A step's marker is written after all of its artefacts, and whole or not at all: a
    run that is killed at any moment repeats the step it was in and no other.

    Args:
        folder: The folder of the run.
        config: The configuration of the run, plain data.

    Attributes:
        folder: The folder of the run.
        config: The configuration of the run, plain data.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        self.config = dict(config)
        self._lock: TextIO | None = None

    @classmethod
    def create(cls, folder: Path | str, config: Mapping[str, Any]) -> RunStore:
        """Begin a run in ``folder``.

        Raises:
            ConfigError: If the folder holds a run already.
        """
        folder = Path(folder)
        if (folder / CONFIG).exists():
            raise ConfigError(
                f"{folder} holds a run already; choose another out=FOLDER, or continue it: resume={folder}."
            )
        folder.mkdir(parents=True, exist_ok=True)
        store = cls(folder, config)
        store._take_lock()
        with atomic_path(folder / CONFIG) as temporary:
            OmegaConf.save(OmegaConf.create(to_plain(dict(config))), temporary)
        return store

    @classmethod
    def open(cls, folder: Path | str) -> RunStore:
        """Open the run in ``folder`` to continue it.

        Raises:
            ConfigError: If there is no run, or another process is working on it.
            DataError: If the configuration of the run cannot be read.
        """
        store = cls(Path(folder), read_config(Path(folder)))
        store._take_lock()
        store._sweep_out()
        return store

    @property
    def is_finished(self) -> bool:
        """Whether the whole run is done, with its summary; one that is lost is written anew from the steps."""
        return self.is_done(DONE) and self.path(SUMMARY).is_file()

    @property
    def has_begun(self) -> bool:
        """Whether any step is done."""
        return any(self.path("steps").rglob("*.json"))

    def is_done(self, step: str) -> bool:
        """Say whether a step is done."""
        return self._marker(step).is_file()

    def result(self, step: str) -> Any:
        """Return what a finished step has left (plain data)."""
        return read_json(self._marker(step))["result"]

    def finish(self, step: str, result: Any = None) -> None:
        """Mark a step as done; all of its artefacts must lie in their places."""
        write_json(self._marker(step), {"step": step, "result": result})

    def step(self, name: str, work: Callable[[], Any]) -> Any:
        """Return the result of a step, doing the work only if the step is not done.

        The result passes through JSON either way, so a resumed run computes with the same numbers.
        """
        if not self.is_done(name):
            self.finish(name, work())
        return self.result(name)

    def path(self, *parts: str) -> Path:
        """Return a path in the run's folder."""
        return self.folder.joinpath(*parts)

    def loop(self, loop: int, *parts: str) -> Path:
        """Return a path in the folder of a loop, ``RUN/loops/KK``."""
        return self.path("loops", f"{loop:02d}", *parts)

    @contextlib.contextmanager
    def new_folder(self, path: Path) -> Iterator[Path]:
        """Yield a temporary folder that becomes ``path`` once the block ends without an exception.

        A folder that a killed run left there is replaced.
        """
        with atomic_path(path) as temporary:
            temporary.mkdir(parents=True)
            yield temporary
            if path.is_dir():
                shutil.rmtree(path)

    def close(self) -> None:
        """Let other processes work on the run."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _marker(self, step: str) -> Path:
        return self.path("steps", *f"{step}.json".split("/"))

    def _take_lock(self) -> None:
        """Hold the folder for this process; the system lets go of it however the process ends."""
        if fcntl is None:
            return
        lock = open(self.path(".lock"), "w")  # noqa: SIM115 - held open as long as the run
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            lock.close()
            raise ConfigError(f"Another process is working on {self.folder}; wait for it or stop it.") from error
        self._lock = lock

    def _sweep_out(self) -> None:
        """Delete the temporary files that a killed process could not."""
        for leftover in self.folder.rglob(".*.tmp*"):
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)


def read_config(folder: Path) -> dict[str, Any]:
    """Read the configuration of the run in ``folder``.

    Raises:
        ConfigError: If there is no run.
        DataError: If the file cannot be read.
    """
    path = folder / CONFIG
    if not path.is_file():
        raise ConfigError(f"There is no run in {folder} (no {CONFIG}); give resume= the folder of a run.")
    try:
        config = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except Exception as error:
        raise DataError(f"{path} cannot be read ({type(error).__name__}); start a new run.") from error
    if not isinstance(config, dict):
        raise DataError(f"{path} holds no configuration; start a new run.")
    return {str(k): v for k, v in config.items()}


def newest_unfinished(root: Path) -> Path:
    """Return the newest run under ``root`` that is not finished.

    Raises:
        ConfigError: If there is none.
    """
    runs = [path.parent for path in root.rglob(CONFIG) if not (path.parent / "steps" / f"{DONE}.json").is_file()]
    if not runs:
        raise ConfigError(f"There is no unfinished run under {root}{os.sep}; name the folder of a run: resume=FOLDER.")
    return max(runs, key=lambda run: (run / CONFIG).stat().st_mtime)
