"""One run: from its configuration to its report."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import OmegaConf

from prgbd.cli.display import Display, log_file, quiet
from prgbd.cli.hydra_errors import known_options
from prgbd.cli.options import MOST_THREADS, RunOptions, read_options
from prgbd.cli.parts import Parts, make_parts
from prgbd.cli.run_folder import RunFolder
from prgbd.cli.settings import check_machine, trainer_factory, use_threads
from prgbd.core.blame import blaming_plugins
from prgbd.core.errors import ConfigError, DataError, PartlyFailedError, PrgbdError
from prgbd.core.option_errors import unknown_option
from prgbd.core.registry import KINDS
from prgbd.io.command import complain
from prgbd.io.files import atomic_path, read_json, to_plain
from prgbd.loop.outcome import failure
from prgbd.loop.store import CONFIG, DONE, SUMMARY, RunStore, read_config
from prgbd.loop.summary import RunIdentity
from prgbd.version import __version__

if TYPE_CHECKING:
    from prgbd.core.data import Sequence
    from prgbd.training.trainers import TrainerFactory

log = logging.getLogger("prgbd")
META = "run"  # the key of config.yaml under which prgbd keeps its own notes
# What they are, and the groups that a run's configuration has whatever its plug-ins.
_NOTES = {"overrides": list, "choices": dict, "started_in": str, "threads": int}
_GROUPS = ("task", "data", "training", "trainer", "logger")
NO_PART = (META, "out", "resume", "debug", "progress", "viz")  # of what makes two runs the same
MOST_LOOKS = 8  # recordings that are looked at before a run


@dataclass
class Job:
    """What a task works with.

    Attributes:
        config: The whole configuration, plain data.
        options: The options that were read from it.
        parts: The plug-ins.
        store: The run.
        display: The terminal and the log.
        here: Where the user is, which is not where a resumed run works.
    """

    config: Mapping[str, Any]
    options: RunOptions
    parts: Parts
    store: RunStore
    display: Display
    here: Path

    @cached_property
    def trainer(self) -> TrainerFactory:
        """The Lightning configuration of whatever the run trains and predicts."""
        return trainer_factory(self.config)

    @property
    def identity(self) -> RunIdentity:
        """What the run is about."""
        ids = self.parts.ids
        return RunIdentity(self.options.task.name, ids["slam"], ids["depth"], ids["data"], self.options.seed)

    def shown(self, path: Path) -> str:
        """Return a path as the user would type it."""
        path = path.resolve()
        return str(path.relative_to(self.here)) if path.is_relative_to(self.here) else str(path)


def start(config: dict[str, Any], folder: Path, overrides: list[str], choices: Mapping[str, Any]) -> None:
    """Start a run in ``folder``.

    Args:
        config: The whole configuration, plain data.
        folder: The run's folder.
        overrides: What the user typed, kept for the report and for ``resume``.
        choices: What was chosen of every group, kept for ``resume``.

    Raises:
        PrgbdError: If something the user can mend is wrong.
    """
    quiet()
    about = {"version": __version__, "started_in": os.getcwd(), "overrides": overrides, "choices": dict(choices)}
    try:
        _refuse_unread(config, overrides)
        options = read_options(config)
        noted = {**config, META: {**about, "threads": use_threads(options.threads)}}
        check_machine(options, config)
        with blaming_plugins():
            parts = make_parts(options)
        store = RunStore.create(folder, noted)
    except BaseException:
        RunFolder.take_back()
        raise
    try:
        _note_overrides(folder, overrides)
        _run(Job(config, options, parts, store, make_display(options.progress), Path.cwd()))
    finally:
        store.close()


def resume(folder: Path, changes: Mapping[str, Any]) -> None:
    """Go on with the run in ``folder``.

    Args:
        folder: The run's folder.
        changes: Harmless options that the user wants to be different this time.

    Raises:
        PrgbdError: If there is no run to go on with, or something the user can mend is wrong.
    """
    quiet()
    here = Path.cwd()
    folder = folder.resolve()
    store = RunStore.open(folder)
    try:
        check_saved(store.config, folder)
        config = {key: value for key, value in store.config.items() if key != META} | dict(changes)
        display = make_display(config.get("progress", "auto"))
        if store.is_finished:
            display.say(f"The run in {folder} is finished; there is nothing left to do.")
            _raise_failure(store)
            return
        with _working_folder(store.config.get(META, {}).get("started_in")):
            options = read_options(config)
            use_threads(store.config.get(META, {}).get("threads", options.threads))
            with blaming_plugins():
                parts = make_parts(options)
            display.say(f"Going on with {folder}")
            _run(Job(config, options, parts, store, display, here))
    finally:
        store.close()


def check_saved(config: Mapping[str, Any], folder: Path) -> None:
    """Refuse the configuration of a run that has lost parts.

    Raises:
        DataError: If a group that every run has is absent, or prgbd's own notes are none.
    """
    notes = config.get(META, {})
    whole = isinstance(notes, dict) and all(isinstance(notes.get(key, made()), made) for key, made in _NOTES.items())
    whole = whole and 1 <= notes.get("threads", 1) <= MOST_THREADS
    lost = [group for group in _GROUPS if not isinstance(config.get(group), dict)] + [META] * (not whole)
    if lost:
        raise DataError(f"{folder / CONFIG} is damaged (its part {lost[0]} is not what a run writes); start a new run.")


def holds_same_run(folder: Path, config: Mapping[str, Any]) -> bool:
    """Whether a folder holds a run of this configuration, begun by an earlier start of the same multirun.

    Raises:
        ConfigError: If it holds a run of another one.
        DataError: If its configuration cannot be read.
    """
    if not os.path.lexists(folder / CONFIG):
        return False
    old, new = read_config(folder), json.loads(json.dumps(to_plain(config)))
    other = sorted(key for key in {*old, *new} - {*NO_PART} if old.get(key) != new.get(key))
    if other:
        raise ConfigError(
            f"{folder} holds a run with other options ({', '.join(other)}); choose another hydra.sweep.dir or out=."
        )
    return True


def make_display(bars: bool | str) -> Display:
    """Make the display that the option ``progress`` asks for."""
    return Display(bars if isinstance(bars, bool) else None)


def _run(job: Job) -> None:
    task = job.options.task.name
    folder = job.store.folder
    work: Callable[[Job], None] = import_module(f"prgbd.cli.tasks.{task}").run
    begin = time.monotonic()
    with log_file(job.store.path("run.log"), job.display.console):
        job.display.header(f"prgbd {task}", _facts(job))
        try:
            with blaming_plugins():
                _look_at_recordings(job, task)
                work(job)
            _end(job, begin)
        except BrokenPipeError:
            log.info("Stopped, for nobody reads the output any more.")
            raise
        except KeyboardInterrupt:
            log.info("Stopped by the user.")
            complain(f"Stopped; what was finished is kept, go on with: python -m prgbd resume={job.shown(folder)}")
            raise SystemExit(130) from None
        except PrgbdError as error:
            log.error("%s\n%s", error, traceback.format_exc())
            if job.store.has_begun and not job.store.is_finished:
                error.add_note(f"What was finished is kept; go on with: python -m prgbd resume={job.shown(folder)}")
            raise
        except Exception:
            log.error("prgbd failed\n%s", traceback.format_exc())
            raise


def _end(job: Job, begin: float) -> None:
    """Mark a run as done, unless a recording failed that another start may find whole.

    Raises:
        PrgbdError: If the run reached nothing, or recordings failed.
    """
    partly = isinstance(failure(read_json(job.store.path(SUMMARY))), PartlyFailedError)
    if not partly:
        job.store.finish(DONE)
    job.display.say(f"Done in {time.monotonic() - begin:.0f} s: {job.shown(job.store.folder)}")
    _raise_failure(job.store)


def _raise_failure(store: RunStore) -> None:
    """Raise what a run that reached its end failed with, if with anything."""
    failed = failure(read_json(store.path(SUMMARY)))
    if failed is not None:
        raise failed


def look_at(sequence: Sequence) -> tuple[str, ...]:
    """Return what seems wrong with a recording, a clause each."""
    from prgbd.tools.preflight import preflight

    return preflight(sequence).warnings


def _look_at_recordings(job: Job, task: str) -> None:
    """Say in two lines what a recording that SLAM or training will use looks like."""
    from prgbd.tools.preflight import preflight

    if task not in ("self_improve", "slam", "pretrain"):
        return
    for sequence in job.parts.sequences[:MOST_LOOKS]:
        facts, verdict = preflight(sequence).lines()
        job.display.say(f"  {sequence.name}: {facts}")
        job.display.say(f"  {' ' * len(sequence.name)}  {verdict}")


def _refuse_unread(config: Mapping[str, Any], overrides: list[str]) -> None:
    """Refuse what was added to the configuration by a plus (``+foo=3``) and nothing reads.

    Raises:
        ConfigError: With the nearest option.
    """
    known = known_options()
    read = {name.partition(".")[0] for name in known} | {*KINDS, "trainer", "logger"}
    for override in overrides:
        key = override.partition("=")[0].lstrip("+")
        top = key.partition(".")[0]
        if override.startswith("+") and top in config and top not in read:
            raise unknown_option(key, known)


def _note_overrides(folder: Path, overrides: list[str]) -> None:
    """Write what the user typed where Hydra would, for the labels of ablation tables and for other people's tools."""
    with atomic_path(folder / ".hydra" / "overrides.yaml") as temporary:
        OmegaConf.save(OmegaConf.create(overrides), temporary)


def _facts(job: Job) -> dict[str, Any]:
    parts = job.parts
    source = {
        "mono": "none (monocular)",
        "rgbd": "the recording's own sensor",
        "stereo": "the right images",
        "pseudo_rgbd": "the network",
    }
    names = ", ".join(f"{s.name} ({len(s)} frames)" for s in parts.sequences[:6])
    more = len(parts.sequences) - 6
    facts = {
        "slam": f"{parts.ids['slam']}, depth from {source[parts.mode]}" if parts.ids["slam"] else "",
        "depth": parts.ids["depth"],
        "data": f"{parts.ids['data']}: {names}{f' and {more} more' if more > 0 else ''}",
        "test": ", ".join(s.name for s in parts.test_sequences),
        "seed": job.options.seed,
        "folder": job.shown(job.store.folder),
    }
    return {key: value for key, value in facts.items() if value != ""}


@contextlib.contextmanager
def _working_folder(folder: str | None) -> Iterator[None]:
    """Work where the run was started, so that its relative paths mean the same."""
    here = Path.cwd()
    if folder is None or not Path(folder).is_dir():
        yield
        return
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(here)
