"""``data=camera`` from the command line, faked by a video that is played at its own rate."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest

import prgbd
from tests.loop import fakes
from tests.plugins.data.filmed import coded, film

RUN = ("+slam=test/sideways", "task=slam", "data=camera", "data.root=a.mp4", "data.fov=60")


@pytest.fixture
def played(tmp_path: Path) -> Path:
    return film(tmp_path / "a.mp4", (coded(i) for i in range(250)))


def pictures(folder: str) -> list[str]:
    return sorted(path.name for path in Path(folder).glob("[0-9]*.jpg"))


def test_a_run_keeps_what_it_sees_and_resume_reads_it_again(cli, played, monkeypatch):
    track = fakes.Sideways.track

    def interrupted(self, frame):
        if frame.index == 8:
            raise KeyboardInterrupt
        return track(self, frame)

    with monkeypatch.context() as patch:
        patch.setattr(fakes.Sideways, "track", interrupted)
        answer = cli(*RUN, "data.frames=20", "out=run")
    assert answer.code == 130
    assert "go on with: python -m prgbd resume=run" in answer.err
    kept = pictures("run/camera")
    assert len(kept) == 20
    played.unlink()  # nothing is recorded anew
    assert cli("resume=run").code == 0
    assert pictures("run/camera") == kept
    assert prgbd.load_result("run/loops/00/slam/camera").frames == 20
    assert cli(*RUN, "data.folder=run/camera", "out=again").code == 0
    one, other = (prgbd.load_result(f"{run}/loops/00/slam/camera").trajectory for run in ("run", "again"))
    assert one.timestamp.tolist() == other.timestamp.tolist()


@pytest.mark.usefixtures("played")
def test_ctrl_c_ends_the_recording_and_the_run_goes_on_with_all_of_it(cli):
    def press() -> None:
        while len(pictures("run/camera")) < 6:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    answer = cli(*RUN, "out=run")
    thread.join()
    assert answer.code == 0, answer.err
    kept = len(pictures("run/camera"))
    assert 6 <= kept < 200
    assert f"({kept} frames)" in answer.out
    assert "recorded from" in answer.out
    assert prgbd.load_result("run/loops/00/slam/camera").frames == kept
