"""Runs that are killed at any moment, and runs on a disk that is full."""

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from prgbd.core.exit_codes import ExitCode
from prgbd.io.files import is_temporary
from tests.cli.conftest import FAKES
from tests.cli.test_resume import PROGRAM, ROOT
from tests.cli.test_tasks import without_times
from tests.robustness.fuzzing import LARGE, judged_exit

KILLS = 25
LIMITED = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, 8_000)); {PROGRAM}"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


@pytest.mark.skipif(not LARGE, reason="tests/cli/test_resume.py kills runs at chosen moments")
def test_killed_at_any_moment_and_resumed():
    task = ("task.max_loops=2", "task.min_improvement=null")
    begin = time.monotonic()
    subprocess.run([sys.executable, "-c", PROGRAM, *FAKES, *task, "out=whole"], env=ENVIRONMENT, check=True)
    longest = time.monotonic() - begin
    whole = without_times(json.loads(Path("whole/summary.json").read_text()))
    for run in (f"run-{number}" for number in range(KILLS)):
        process = subprocess.Popen([sys.executable, "-c", PROGRAM, *FAKES, *task, f"out={run}"], env=ENVIRONMENT)
        time.sleep(random.uniform(0.4 * longest, longest))
        process.kill()
        process.wait()
        if not Path(run, "config.yaml").exists():
            continue
        resumed = subprocess.run(
            [sys.executable, "-c", PROGRAM, f"resume={run}"], env=ENVIRONMENT, capture_output=True, text=True
        )
        judged_exit("runs that were killed", resumed.returncode, resumed.stderr)
        assert resumed.returncode == 0, resumed.stderr
        assert without_times(json.loads(Path(f"{run}/summary.json").read_text())) == whole
        assert Path(f"{run}/weights/model.pth").read_bytes() == Path("whole/weights/model.pth").read_bytes()


def test_no_room_for_the_predicted_depth(tmp_path):
    command = [sys.executable, "-c", LIMITED, *FAKES, "task=slam", "out=run"]
    process = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, cwd=tmp_path)
    judged_exit("full disks", process.returncode, process.stderr)
    assert process.returncode == ExitCode.INPUT, process.stderr
    assert "cache" in process.stderr
    assert "MB are free; make room" in process.stderr
    assert not [path for path in (tmp_path / "run").rglob("*") if is_temporary(path)]
