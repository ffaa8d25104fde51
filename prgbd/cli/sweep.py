"""Multiruns: a failing run does not stop the others, and one table at the end compares them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from prgbd.cli.display import make_console
from prgbd.core.errors import PrgbdError
from prgbd.core.exit_codes import ExitCode
from prgbd.io.command import complain
from prgbd.io.files import read_json, write_json

ERROR = "error.json"


class AblationTable(Callback):
    """Hydra callback: joins the summaries of a multirun into one table and prints it."""

    last_sweep: Path | None = None

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Remember the folder of the multirun."""
        AblationTable.last_sweep = Path(str(config.hydra.sweep.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table of all runs that ended."""
        from prgbd.report import ablation
        from prgbd.report.rendering import to_rich

        folder = Path(str(config.hydra.sweep.dir))
        if not any(folder.glob("*/summary.json")):
            return
        try:
            paths = ablation.join(folder)
            console = make_console()
            for table in ablation.ablation_tables(folder):
                console.print(to_rich(table))
            console.print(f"Table: {', '.join(str(path) for path in paths)}", highlight=False)
        except PrgbdError as error:
            complain(str(error))


def note_failure(folder: Path, error: BaseException) -> None:
    """Leave a note in the folder of a run of a multirun that failed."""
    folder.mkdir(parents=True, exist_ok=True)
    code = error.exit_code if isinstance(error, PrgbdError) else ExitCode.BUG
    write_json(folder / ERROR, {"error": type(error).__name__, "message": str(error), "exit_code": int(code)})


def forget_failure(folder: Path) -> None:
    """Take away the note of an earlier start of the same multirun."""
    (folder / ERROR).unlink(missing_ok=True)


def exit_code(folder: Path | None) -> int:
    """Return 0 if every run of the multirun in ``folder`` went well, 1 after a bug, else the failures' own, or 2."""
    notes = [read_json(path) for path in sorted(folder.glob(f"*/{ERROR}"))] if folder is not None else []
    if not notes:
        return 0
    complain(f"{len(notes)} of the runs failed; see the messages above and {folder}{'/'}*/{ERROR}.")
    codes = {int(note["exit_code"]) for note in notes}
    if ExitCode.BUG in codes:
        return ExitCode.BUG
    return codes.pop() if len(codes) == 1 else ExitCode.INPUT
