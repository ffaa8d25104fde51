"""What people see while prgbd runs: a header, progress with rate and time left, and lines; also in ``run.log``."""

from __future__ import annotations

import contextlib
import logging
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from prgbd.io.disk import writing
from prgbd.io.reading import require_file

log = logging.getLogger("prgbd")
_PLAIN_INTERVAL = 30.0  # seconds between progress lines where there is no terminal
_NARROW = 110  # columns; a narrower terminal gets no bar, short words and short titles
_NARROW_TITLE = 26
_SHORT = {"keyframes": "kf", "points": "pts"}
_COLOURS = {"ok": "green", "lost": "red", "finishing": "cyan"}
_CHATTERERS = ("lightning", "lightning.pytorch", "lightning.fabric", "pytorch_lightning", "numba", "matplotlib", "PIL")


class _Rate(ProgressColumn):
    """Units per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{speed:5.1f}/s" if speed else "   -/s", style="dim")


class _WorkClock:
    """A clock in seconds that stands still for what is not the work of a stage."""

    def __init__(self) -> None:
        self._left_out = 0.0

    def __call__(self) -> float:
        return time.monotonic() - self._left_out

    def leave_out(self, seconds: float) -> None:
        self._left_out += seconds


class _Bar:
    """A stage on a terminal."""

    def __init__(self, progress: Progress, task: Any, clock: _WorkClock) -> None:
        self._progress, self._task = progress, task
        self.leave_out = clock.leave_out
        self.done = 0

    def advance(self, units: int = 1, **fields: Any) -> None:
        self.done += units
        self._progress.update(
            self._task, advance=units, note=_noted(fields, narrow=self._progress.console.width < _NARROW)
        )


class _Lines:
    """A stage where there is no terminal: a line now and then."""

    def __init__(self, display: Display, title: str, total: int, clock: _WorkClock) -> None:
        self._display, self._title, self._total, self._clock = display, title, total, clock
        self.leave_out = clock.leave_out
        self.done = 0
        self._begin = self._last = clock()

    def advance(self, units: int = 1, **fields: Any) -> None:
        self.done += units
        now = self._clock()
        if now - self._last > _PLAIN_INTERVAL and self.done < self._total:
            self._last = now
            rate = self.done / (now - self._begin)
            left = (self._total - self.done) / rate
            parts = [f"{self.done}/{self._total}", f"{rate:.1f}/s", f"{_clock(left)} left", *_notes(fields)]
            self._display.say(f"{self._title}: {', '.join(parts)}")


class Display:
    """The terminal and the log of one run; a ``Monitor`` of the loop.

    Args:
        bars: Whether to draw progress bars; None draws them on a terminal.
    """

    def __init__(self, bars: bool | None = None) -> None:
        self.console = make_console()
        self.bars = self.console.is_terminal if bars is None else bars

    def say(self, text: str) -> None:
        """Print and log one line."""
        self.console.print(escape(text), highlight=False)
        log.info(text)

    def header(self, title: str, facts: Mapping[str, Any]) -> None:
        """Print and log what runs, where, and with which seed."""
        self.console.print(f"[bold]{escape(title)}[/bold]")
        width = max((len(key) for key in facts), default=0)
        for key, value in facts.items():
            self.console.print(f"  [dim]{key:<{width}}[/dim]  {escape(str(value))}", highlight=False)
        log.info("%s: %s", title, ", ".join(f"{k} {v}" for k, v in facts.items()))

    @contextlib.contextmanager
    def stage(self, title: str, total: int) -> Iterator[_Bar | _Lines]:
        """Show the progress of a stage of ``total`` units; see ``Monitor.stage``."""
        clock = _WorkClock()
        begin = clock()
        if self.bars:
            narrow = self.console.width < _NARROW
            columns = (
                TextColumn("{task.description}"),
                *([] if narrow else [BarColumn(bar_width=24)]),
                MofNCompleteColumn(),
                _Rate(),
                TimeRemainingColumn(compact=True),
                TextColumn("{task.fields[note]}", style="dim"),
            )
            with Progress(*columns, console=self.console, transient=True, get_time=clock) as progress:
                label = escape(_shortened(title, _NARROW_TITLE) if narrow else title)
                shown: _Bar | _Lines = _Bar(progress, progress.add_task(label, total=total, note=""), clock)
                yield shown
        else:
            shown = _Lines(self, title, total, clock)
            yield shown
        seconds = clock() - begin
        self.say(f"{title}: {shown.done} in {seconds:.1f} s, {shown.done / max(seconds, 1e-6):.1f}/s")


class _Console(Console):
    """A console that leaves it to the command how it ends when nobody reads its output any more."""

    def on_broken_pipe(self) -> None:
        """Pass the error on; rich would exit with code 1."""
        raise BrokenPipeError


def make_console(*, stderr: bool = False) -> Console:
    """Return a console that does not break lines where the output is a file or a pipe."""
    console = _Console(stderr=stderr)
    return console if console.is_terminal else _Console(stderr=stderr, width=200, color_system=None)


class _LogFile(logging.FileHandler):
    """A log that a full disk does not stop: whoever writes results says so."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Leave the line out."""


class _Shown(logging.Handler):
    """Shows the warnings of prgbd's own parts; errors are told by whoever handles them."""

    def __init__(self, console: Console) -> None:
        super().__init__(logging.WARNING)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno == logging.WARNING:
            self._console.print(escape(record.getMessage()), style="dim", highlight=False)


@contextlib.contextmanager
def log_file(path: Path, console: Console) -> Iterator[None]:
    """Send the log and all warnings to ``path`` for a while, and keep the libraries' chatter off the terminal.

    Args:
        path: The file; it is appended to.
        console: Where warnings of prgbd's own parts are shown as well.
    """
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            require_file(path, "the log of the run")
        handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    root = logging.getLogger()
    level = root.level
    root.addHandler(handler)
    shown = _Shown(console)
    log.addHandler(shown)
    root.setLevel(logging.INFO)
    quiet()
    logging.captureWarnings(True)
    warned = logging.getLogger("py.warnings")
    propagated = warned.propagate
    try:
        yield
    finally:
        logging.captureWarnings(False)
        warned.propagate = propagated
        root.setLevel(level)
        root.removeHandler(handler)
        log.removeHandler(shown)
        handler.close()


def quiet() -> None:
    """Keep libraries from talking about themselves."""
    for name in _CHATTERERS:
        logging.getLogger(name).setLevel(logging.ERROR)
    for message in (".*does not have many workers.*", ".*srun.*", ".*GPU available but not used.*", ".*litlogger.*"):
        warnings.filterwarnings("ignore", message=message)


def _notes(fields: Mapping[str, Any], *, narrow: bool = False) -> list[str]:
    """Say each field in as few words as people need: ``ok``, ``42 keyframes``, ``loss 0.0312``."""
    notes = []
    for key, value in fields.items():
        if key == "state":
            notes.append(str(value))
        elif isinstance(value, int) and not isinstance(value, bool):
            word = _SHORT.get(key, key) if narrow else key
            notes.append(f"{value:,} {word.removesuffix('s') if value == 1 else word}")
        else:
            notes.append(f"{key} {value}")
    return notes


def _noted(fields: Mapping[str, Any], *, narrow: bool) -> str:
    """The fields as rich markup; the state of tracking in a colour."""
    notes = [escape(note) for note in _notes(fields, narrow=narrow)]
    if "state" in fields:
        at = list(fields).index("state")
        notes[at] = f"[not dim {_COLOURS.get(str(fields['state']), 'yellow')}]{notes[at]}[/]"
    return "  ".join(notes)


def _shortened(title: str, width: int) -> str:
    """Leave out the middle of a title that is too long; its end tells recordings apart."""
    keep = width - 1
    return title if len(title) <= width else f"{title[: keep // 2]}…{title[-(keep - keep // 2) :]}"


def _clock(seconds: float) -> str:
    """Return a time as ``0:07``, ``12:34`` or ``1:02:03``."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
