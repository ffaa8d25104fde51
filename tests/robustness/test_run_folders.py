"""Damaged run folders: whatever was done to a file, reading it ends in its value or in one sentence."""

import json
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from prgbd.core.errors import ContractError
from prgbd.core.validation import check_name
from prgbd.io.export import load_result
from prgbd.loop.store import RunStore
from prgbd.report.__main__ import main as report_command
from prgbd.report.reading import open_run
from prgbd.tools.__main__ import main as tools_command
from tests.cli.conftest import FAKES
from tests.robustness.fuzzing import examples, judged, judged_exit

SCALARS = st.one_of(st.none(), st.booleans(), st.integers(-(10**30), 10**30), st.floats(), st.text(max_size=5))
VALUES = st.one_of(SCALARS, st.lists(SCALARS, max_size=2), st.dictionaries(st.text(max_size=5), SCALARS, max_size=2))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run folder of two loops; and a decoy beside it, which nothing may touch."""
    from prgbd.__main__ import main
    from tests.loop import fakes

    fakes.register()
    place = tmp_path_factory.mktemp("runs")
    (place / "decoy").mkdir()
    (place / "decoy" / "kept.txt").write_text("kept")
    assert main([*FAKES, "task.max_loops=1", "export=[tum]", f"out={place / 'whole'}"]) == 0
    return place / "whole"


@pytest.fixture
def damaged(whole):
    """A copy of the run, made anew for every input; the decoy is looked at afterwards."""

    def copy() -> Path:
        target = whole.parent / "damaged"
        shutil.rmtree(target, ignore_errors=True)
        return Path(shutil.copytree(whole, target))

    yield copy
    assert {path.name: path.read_text() for path in (whole.parent / "decoy").iterdir()} == {"kept.txt": "kept"}
    assert {path.name for path in whole.parent.iterdir()} <= {"whole", "decoy", "damaged"}


def mutate(content: bytes, draw) -> bytes:
    """Cut, empty or change the bytes of a file."""
    how = draw(st.sampled_from(["empty", "cut", "flip", "insert", "other"]))
    at = draw(st.integers(0, max(0, len(content) - 1)))
    if how == "empty":
        return b""
    if how == "cut":
        return content[:at]
    if how == "flip":
        return content[:at] + bytes([content[at] ^ draw(st.integers(1, 255))]) + content[at + 1 :] if content else b"x"
    if how == "insert":
        return content[:at] + draw(st.binary(min_size=1, max_size=8)) + content[at:]
    return draw(st.binary(max_size=40))


def edit(value, draw):
    """Replace, delete or add something somewhere in plain data."""
    if not isinstance(value, dict | list) or not value or draw(st.integers(0, 3)) == 0:
        return draw(VALUES)
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    key = draw(st.sampled_from(keys))
    if draw(st.integers(0, 4)) == 0:
        del value[key]
    else:
        value[key] = edit(value[key], draw)
    return value


def files_of(run: Path, *endings: str) -> list[str]:
    found = sorted(path.relative_to(run).as_posix() for path in run.rglob("*") if path.is_file())
    return [name for name in found if name.endswith(endings) and name != ".lock"]


def spoil(run: Path, name: str, draw) -> None:
    path = run / name
    if name.endswith(".json") and draw(st.booleans()):
        path.write_text(json.dumps(edit(json.loads(path.read_text()), draw)))
    else:
        path.write_bytes(mutate(path.read_bytes(), draw))


@examples(small=12, large=250)
@given(data=st.data())
def test_reports_of_damaged_runs(whole, damaged, capfd, monkeypatch, data):
    monkeypatch.setattr("prgbd.report.page.render", lambda run: "")
    run = damaged()
    spoil(run, data.draw(st.sampled_from(files_of(run, ".json", ".yaml", ".npz", ".csv", ".tum"))), data.draw)
    capfd.readouterr()
    code = report_command([str(run)])
    judged_exit("reports of damaged runs", code, capfd.readouterr().err)


@examples(small=6, large=150)
@given(data=st.data())
def test_pages_of_edited_summaries(whole, damaged, data):
    from prgbd.report.page import write_report

    run = damaged()
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps(edit(summary, data.draw)))
    with judged("edited summaries"):
        write_report(run)


@examples(small=25, large=400)
@given(data=st.data())
def test_leaderboards_and_results_of_damaged_runs(whole, damaged, capfd, data):
    run = damaged()
    spoil(run, data.draw(st.sampled_from(files_of(run, "summary.json", ".yaml", ".npz"))), data.draw)
    capfd.readouterr()
    code = tools_command(["leaderboard", str(run)])
    judged_exit("leaderboards of damaged runs", code, capfd.readouterr().err)
    with judged("damaged results"):
        load_result(run / "loops/00/slam/wall")
    with judged("damaged summaries"):
        open_run(run)


@examples(small=8, large=200)
@given(data=st.data())
def test_damaged_runs_that_go_on(whole, damaged, capfd, monkeypatch, data):
    from prgbd.__main__ import main

    monkeypatch.setattr("prgbd.report.page.write_report", lambda run: None)
    run = damaged()
    spoil(run, data.draw(st.sampled_from(files_of(run, "config.yaml", ".json"))), data.draw)
    for name in ("steps/done.json", data.draw(st.sampled_from(files_of(run / "steps", ".json")))):
        (run / "steps" / name.removeprefix("steps/")).unlink(missing_ok=True)
    capfd.readouterr()
    code = main([f"resume={run}", "progress=false"])
    judged_exit("damaged runs that go on", code, capfd.readouterr().err)


@examples(small=40, large=400)
@given(content=st.one_of(st.binary(max_size=60), VALUES.map(lambda value: json.dumps(value).encode())))
def test_steps_of_any_content(tmp_path_factory, content):
    store = RunStore(tmp_path_factory.getbasetemp() / "steps-of-any-content", {})
    store.finish("a", {"x": 1})
    store.path("steps", "a.json").write_bytes(content)
    with judged("damaged steps"):
        store.result("a")


@examples(small=60, large=600)
@given(name=st.one_of(st.text(max_size=12), st.sampled_from(["..", "/etc", "../x", "a/../b", "con", "x" * 300, "\0"])))
def test_names_lead_nowhere(tmp_path_factory, name):
    folder = tmp_path_factory.getbasetemp() / "names"
    with judged("names of recordings"):
        check_name(name, "The recording")
        assert folder.joinpath(name).parent == folder
        assert RunStore(folder, {}).loop(0, "slam", name).resolve().parent == (folder / "loops/00/slam").resolve()


def test_a_name_with_a_slash_is_refused():
    with pytest.raises(ContractError):
        check_name("a/b", "It")
