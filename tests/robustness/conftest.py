"""Every test here runs in an empty folder beside a decoy, and nothing outside of what the test made may change."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.robustness.fuzzing import TALLY, table

FILES = {"notes.txt": b"mine", "photos/a.jpg": b"\xff\xd8\xff\xd9", "photos/.hidden": b"", "empty/.keep": b""}


@pytest.fixture(autouse=True)
def decoy(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of the user's that no input may change; it is the home folder, and lies above the working folder."""
    base = tmp_path_factory.mktemp("user")
    folder = base / "decoy"
    for name, content in FILES.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    work = base / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    monkeypatch.setenv("PRGBD_DECOY", str(folder))
    before, beside = fingerprint(folder), sorted(os.listdir(base))
    yield folder
    assert fingerprint(folder) == before, "a folder of the user's was changed"
    assert sorted(os.listdir(base)) == beside, "something was written above the working folder"


def fingerprint(folder: Path) -> dict[str, str]:
    """Return the digest of everything in a folder, empty folders too."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in sorted(folder.rglob("*"))
    }


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand the counts of a worker process to the main one."""
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["tally"] = [[subject, outcome, n] for (subject, outcome), n in TALLY.items()]


@pytest.hookimpl(optionalhook=True)  # pytest-xdist's
def pytest_testnodedown(node) -> None:
    """Take the counts of a worker process."""
    for subject, outcome, n in getattr(node, "workeroutput", {}).get("tally", ()):
        TALLY[subject, outcome] += n


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print how many inputs were tried."""
    lines = table()
    if lines:
        terminalreporter.section("inputs that were tried")
        for line in lines:
            terminalreporter.write_line(line)
