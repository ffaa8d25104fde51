"""The command line in this process, with small plug-ins."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from prgbd.__main__ import main
from tests.loop import fakes


@dataclass
class Answer:
    code: int
    out: str
    err: str

    @property
    def sentence(self) -> str:
        """The one line of the error stream that speaks of the error."""
        assert "Traceback" not in self.err + self.out
        lines = [line for line in self.err.splitlines() if line.startswith("prgbd: ")]
        assert len(lines) == 1, self.err
        return lines[0]


@pytest.fixture
def real_report():
    """Asks ``cli`` for real reports; elsewhere their figures are left out, for they take longer than all the rest."""


@pytest.fixture
def cli(capfd, tmp_path, monkeypatch, request):
    """Call the command line in an empty folder."""
    fakes.register()
    if "real_report" not in request.fixturenames:
        monkeypatch.setattr("prgbd.report.page.write_report", lambda run: None)
    fakes.Sideways.tracked_in_process = 0
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Answer:
        capfd.readouterr()
        try:
            code = main(list(arguments))
        except SystemExit as end:
            code = int(end.code or 0)
        captured = capfd.readouterr()
        return Answer(code, captured.out, captured.err)

    return call


FAKES = ("+slam=test/sideways", "+depth=test/tiny", "data=test/wall", "training.learning_rate=1e-2")


@pytest.fixture
def run(cli):
    """Run a task on the small plug-ins in the folder ``run`` and return its summary."""

    def call(*arguments: str, fakes: tuple[str, ...] = FAKES) -> dict:
        answer = cli(*fakes, "out=run", *arguments)
        assert answer.code == 0, answer.err
        return json.loads(Path("run/summary.json").read_text())

    return call
