"""``RunStore``: what a run has finished, where it lies, and how it goes on after it was stopped."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

from omegaconf import OmegaConf

from prgbd.core.errors import ConfigError, DataError
from prgbd.io.disk import writing
from prgbd.io.files import atomic_path, is_temporary, read_json, remove, to_plain, write_json
from prgbd.io.reading import read_text

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows: runs there are not protected against a second process
    fcntl = None  # type: ignore[assignment]

CONFIG = "config.yaml"
SUMMARY = "summary.json"
DONE = "done"
LOCK = ".lock"
FOLDERS = ("baselines", "cache", "depth", "loops", "maps", "steps", "training", "truth", "viz", "weights")
"""The folders that runs make, and replace what is in them."""


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
            ConfigError: If the folder holds a run already, or something that the run would replace.
            DiskError: If the folder cannot be written to.
        """
        folder = Path(folder)
        if (folder / CONFIG).exists():
            raise ConfigError(
                f"{folder} holds a run already; choose another out=FOLDER, or continue it: resume={folder}."
            )
        for name in (*FOLDERS, SUMMARY):
            if os.path.lexists(folder / name):
                raise ConfigError(
                    f"{folder} holds {name} already, which the run would replace; choose another out=FOLDER."
                )
        with writing(folder / CONFIG):
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
        """Return what a finished step has left (plain data).

        Raises:
            DataError: If the file was changed since, by a damaged disk or by somebody.
        """
        path = self._marker(step)
        marker = read_json(path)
        given = marker.get("sha256") if isinstance(marker, dict) else None
        if given is None or given != _fingerprint(step, marker.get("result")):
            raise DataError(f"{path} is not what the run has written; delete it, so that the step is done again.")
        return marker["result"]

    def finish(self, step: str, result: Any = None) -> None:
        """Mark a step as done; all of its artefacts must lie in their places."""
        plain = to_plain(result)
        write_json(self._marker(step), {"step": step, "result": plain, "sha256": _fingerprint(step, plain)})

    def forget(self, *steps: str) -> None:
        """Take the marks from steps, so that they are done again."""
        for step in steps:
            self._marker(step).unlink(missing_ok=True)

    def forget_below(self, *steps: str) -> None:
        """Take the marks from all steps whose names begin with one of these and a slash."""
        for step in steps:
            remove(self._marker(step).with_suffix(""))

    def step(self, name: str, work: Callable[[], Any]) -> Any:
        """Return the result of a step, doing the work only if the step is not done.

        The result passes through JSON either way, so a resumed run computes with the same numbers.
        """
        if not self.is_done(name):
            self.finish(name, work())
        return self.result(name)

    def path(self, *parts: str) -> Path:
        """Return a path in the run's folder.

        Raises:
            ConfigError: If it leads out of the folder, by its parts or by a link.
        """
        path = self.folder.joinpath(*parts)
        if ".." in Path(*parts).parts or not path.resolve().is_relative_to(self.folder.resolve()):
            raise ConfigError(
                f"{path} leads out of the folder of the run, {self.folder}; remove the link or rename it."
            )
        return path

    def loop(self, loop: int, *parts: str) -> Path:
        """Return a path in the folder of a loop, ``RUN/loops/KK``."""
        return self.path("loops", f"{loop:02d}", *parts)

    @contextlib.contextmanager
    def new_folder(self, path: Path) -> Iterator[Path]:
        """Yield a temporary folder that becomes ``path`` once the block ends without an exception.

        A folder that a killed run left there is replaced.

        Raises:
            ConfigError: If the path is none of those that belong to runs, see ``FOLDERS``.
            DiskError: If the disk is full, or may not be written to.
        """
        within = self.path(os.path.relpath(path, self.folder))
        if within.relative_to(self.folder).parts[:1] not in {(name,) for name in FOLDERS}:
            raise ConfigError(f"{path} is no folder of a run; those are {', '.join(FOLDERS)}.")
        with atomic_path(path) as temporary:
            temporary.mkdir(parents=True)
            yield temporary
            remove(path)

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
        path = self.path(LOCK)
        if path.exists() and not path.is_file():
            raise ConfigError(f"{path} is no file; remove it.")
        with writing(path):
            lock = open(path, "a")  # noqa: SIM115 - held open as long as the run
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            lock.close()
            raise ConfigError(f"Another process is working on {self.folder}; wait for it or stop it.") from error
        self._lock = lock

    def _sweep_out(self) -> None:
        """Delete the temporary files that a killed process could not, but those of runs inside this run's folder."""
        for place, folders, files in os.walk(self.folder):
            if CONFIG in files and Path(place) != self.folder:
                folders.clear()
                continue
            for leftover in (Path(place, name) for name in (*folders, *files)):
                if is_temporary(leftover):
                    with contextlib.suppress(OSError):  # it does no harm
                        remove(leftover)
            folders[:] = [name for name in folders if not is_temporary(Path(name))]


def _fingerprint(step: str, result: Any) -> str:
    """Return what a step's result is recognised by, whatever spaces its file has."""
    return hashlib.sha256(json.dumps([step, result], sort_keys=True).encode()).hexdigest()[:16]


def read_config(folder: Path) -> dict[str, Any]:
    """Read the configuration of the run in ``folder``.

    Raises:
        ConfigError: If there is no run.
        DataError: If the file cannot be read.
    """
    path = folder / CONFIG
    if not os.path.lexists(path):
        raise ConfigError(f"There is no run in {folder} (no {CONFIG}); give resume= the folder of a run.")
    text = read_text(path, "the configuration of a run")
    try:
        config = OmegaConf.to_container(OmegaConf.create(text), resolve=True)
    except Exception as error:
        raise DataError(f"{path} cannot be read ({type(error).__name__}); start a new run.") from error
    if not isinstance(config, dict) or not config:
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
