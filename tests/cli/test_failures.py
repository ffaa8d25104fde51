"""Runs that fail, in part or as a whole: their exit codes, and what they leave."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from prgbd.core.exit_codes import ExitCode
from tests.cli.conftest import FAKES
from tests.cli.test_resume import PROGRAM, ROOT
from tests.cli.test_tasks import without_times


@pytest.fixture
def two_walls(tmp_path):
    root = tmp_path / "walls"
    root.mkdir()
    return root


def summary(run="run"):
    return json.loads(Path(run, "summary.json").read_text())


@pytest.mark.parametrize("task", [("task.max_loops=2", "task.min_improvement=null"), ("task=slam",), ("task=depth",)])
def test_an_error_in_one_recording_of_two_is_reported_and_tried_again(cli, two_walls, task):
    (two_walls / "10.broken").touch()
    given = (*FAKES, *task, f"data.root={two_walls}")
    answer = cli(*given, "out=run")
    assert answer.code == ExitCode.PARTLY_FAILED
    assert "1 of 2 recordings failed: 10: Frame 5 of 10 is truncated" in answer.sentence
    assert summary()["failed_sequences"] == {"10": "Frame 5 of 10 is truncated; copy it anew."}
    assert set(summary()["loops"][-1]["pose"]) == ({"00"} if task != ("task=depth",) else set())
    assert cli("resume=run").code == ExitCode.PARTLY_FAILED

    (two_walls / "10.broken").unlink()
    answer = cli("resume=run")
    assert answer.code == 0, answer.err
    assert cli(*given, "out=whole").code == 0
    assert without_times(summary()) == without_times(summary("whole"))
    if task[0] == "task.max_loops=2":
        assert Path("run/weights/model.pth").read_bytes() == Path("whole/weights/model.pth").read_bytes()


def test_an_error_in_every_recording_is_an_error(cli, two_walls):
    for name in ("00", "10"):
        (two_walls / f"{name}.broken").touch()
    answer = cli(*FAKES, "task=slam", f"data.root={two_walls}", "out=run")
    assert answer.code == ExitCode.INPUT
    assert "truncated" in answer.sentence


def test_a_run_that_tracked_nothing_says_so(cli, monkeypatch, real_report):
    from dataclasses import replace

    from prgbd.core.types import Trajectory
    from tests.loop.fakes import Sideways

    finish = Sideways.finish
    monkeypatch.setattr(Sideways, "finish", lambda self: replace(finish(self), trajectory=Trajectory.empty()))
    answer = cli(*FAKES, "task=slam", "out=run")
    assert answer.code == ExitCode.NOTHING_TRACKED
    assert "Nothing was tracked in wall: images of 96x64 are too small" in answer.sentence
    assert summary()["loops"][0]["pose"]["wall"]["failed"].startswith("images of 96x64")
    assert "The run failed. Nothing was tracked in wall" in Path("run/report.html").read_text()
    again = cli("resume=run")
    assert again.code == ExitCode.NOTHING_TRACKED
    assert "nothing left to do" in again.out


def test_a_multirun_that_is_started_again_goes_on(cli, monkeypatch):
    from prgbd.loop.store import RunStore

    command = ("-m", *FAKES, "task.max_loops=0", "seed=0,1,2", "hydra.sweep.dir=sweep")
    finish = RunStore.finish

    def stop_in_the_second(self, name, result=None):
        finish(self, name, result)
        if self.folder.name == "1" and "slam" in name:
            raise KeyboardInterrupt

    monkeypatch.setattr(RunStore, "finish", stop_in_the_second)
    assert cli(*command).code == 130
    first = Path("sweep/0/summary.json").stat().st_mtime_ns
    assert not Path("sweep/2").exists()
    monkeypatch.setattr(RunStore, "finish", finish)
    answer = cli(*command)
    assert answer.code == 0, answer.err
    assert "0 is finished" in answer.out
    assert Path("sweep/0/summary.json").stat().st_mtime_ns == first
    assert all(Path(f"sweep/{run}/summary.json").is_file() for run in range(3))
    other = cli("-m", *FAKES, "task.max_loops=1", "seed=0,1,2", "hydra.sweep.dir=sweep")
    assert other.code == ExitCode.INPUT
    assert "other options (task)" in other.err


def test_only_folders_that_the_run_made_are_taken_back(cli):
    Path("mine/empty").mkdir(parents=True)
    assert cli(*FAKES, "seed=-1", "out=mine/empty/run").code == ExitCode.INPUT
    assert [path.name for path in Path("mine/empty").iterdir()] == []
    assert cli(*FAKES, "seed=-1", "out=mine/empty").code == ExitCode.INPUT
    assert Path("mine/empty").is_dir()


@pytest.mark.parametrize("name", ["weights", "loops", "summary.json"])
def test_a_folder_with_something_of_the_user_s_is_refused(cli, name):
    Path("mine", name).mkdir(parents=True)
    Path("mine", name, "kept").write_text("kept")
    answer = cli(*FAKES, "out=mine")
    assert answer.code == ExitCode.INPUT
    assert f"holds {name} already" in answer.sentence
    assert Path("mine", name, "kept").read_text() == "kept"


@pytest.mark.parametrize("name", ["../../x", "/etc/decoy", "", ".hidden", "a\\b", "a\nb", "x" * 250, 5])
def test_a_recording_with_a_hostile_name_is_refused(cli, monkeypatch, name):
    from tests.loop.fakes import Wall

    monkeypatch.setattr(Wall, "name", property(lambda self: name, lambda self, value: None), raising=False)
    answer = cli(*FAKES, "task=slam", "out=run")
    assert answer.code == ExitCode.INPUT
    assert "name" in answer.sentence
    assert not Path("run").exists()


def test_nobody_reads_the_output_any_more(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-c", PROGRAM, *FAKES, "task=slam", "out=run"]
    process = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path)
    os.close(writing)
    assert process.returncode == ExitCode.CLOSED
    assert process.stderr == ""


def test_an_image_is_written_or_refused(tmp_path):
    from prgbd.cli.tasks.depth import write_image
    from prgbd.core.errors import DiskError

    write_image(tmp_path / "new" / "a.png", np.zeros((4, 6), np.uint16))
    assert (tmp_path / "new" / "a.png").is_file()
    (tmp_path / "file").write_text("")
    with pytest.raises(DiskError):
        write_image(tmp_path / "file" / "a.png", np.zeros((4, 6), np.uint8))
