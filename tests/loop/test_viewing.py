"""Watching SLAM: what viewers are told, and recordings for rerun where it is installed."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.errors import ConfigError
from prgbd.core.slam import SlamView
from prgbd.loop import viewing
from prgbd.loop.slam_runs import run_slam, sensor_input
from prgbd.loop.viewing import SilentViewer, viewer_maker
from tests.loop.fakes import Sideways, Wall


class Telling(Sideways):
    """Tells its map, and says how large it is."""

    def track(self, frame):
        return replace(super().track(frame), info={"points": 1200, "maps": 1, "secret": 7})

    def view(self):
        points = np.random.default_rng(0).normal(size=(30, 3))
        pose = np.eye(4)[None]
        return SlamView(pose, points, np.full((30, 3), 200, np.uint8), np.array([[10.0, 20.0]], np.float32))


class Witness(SilentViewer):
    def __init__(self):
        self.seen, self.result, self.closed = [], None, False

    def tracked(self, frame, tracked, system):
        assert system.view() is not None
        self.seen.append((frame.index, tracked.state.value, frame.depth is not None))

    def finished(self, result):
        self.result = result

    def __exit__(self, *_):
        self.closed = True


def test_a_viewer_sees_every_frame_and_the_result_and_is_closed():
    witness, sequence = Witness(), Wall(frames=5, sensor=True)
    result = run_slam(Telling, sequence, sensor_input(sequence, "rgbd", None), viewer=witness)
    assert witness.seen == [(i, "ok", True) for i in range(5)]
    assert witness.result.frames == result.frames == 5
    assert witness.closed


def test_the_progress_line_gets_the_sizes_that_the_system_tells():
    told = []

    class Monitor:
        def stage(self, title, total):
            return self

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def advance(self, units=1, **fields):
            told.append((units, fields))

        def say(self, text):
            pass

    sequence = Wall(frames=4)
    run_slam(Telling, sequence, sensor_input(sequence, "mono", None), monitor=Monitor())
    assert told[0] == (1, {"state": "ok", "keyframes": 1, "points": 1200, "maps": 1})
    assert told[-1] == (0, {"state": "finishing"})
    assert sum(units for units, _ in told) == 4


def test_an_unknown_viewer_and_a_missing_package_are_named(monkeypatch):
    assert viewer_maker("none") is None
    with pytest.raises(ConfigError, match="viz=window is unknown; choose none, rerun"):
        viewer_maker("window")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install 'prgbd\[viz\]'"):
        viewer_maker("rerun")


def test_a_live_viewer_needs_a_screen_or_a_running_viewer(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: True)
    monkeypatch.setattr(viewing.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        monkeypatch.setattr(viewing, "RERUN_PORT", closed.getsockname()[1])
        with pytest.raises(ConfigError, match=r"needs a screen.*use viz=rerun "):
            viewer_maker("rerun_live")
        closed.listen()
        assert viewer_maker("rerun_live") is not None
    monkeypatch.setenv("DISPLAY", ":0")
    assert viewer_maker("rerun_live") is not None


@pytest.mark.parametrize("system", [Telling, Sideways])
def test_rerun_gets_a_recording_of_any_system(tmp_path, system):
    pytest.importorskip("rerun")
    make = viewer_maker("rerun")
    assert make is not None
    sequence = Wall(frames=12, sensor=True)
    run_slam(
        system, sequence, sensor_input(sequence, "rgbd", None), viewer=make(sequence, tmp_path / "viz" / "00-wall")
    )
    (path,) = (tmp_path / "viz").iterdir()
    assert path.name == "00-wall.rrd"
    assert subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", path], capture_output=True).returncode == 0
    stats = subprocess.run([sys.executable, "-m", "rerun", "rrd", "stats", path], capture_output=True, text=True).stdout
    rows = {line.split(":")[0]: line.split(":")[1] for line in stats.splitlines() if line.startswith("/")}
    wanted = {"camera", "camera/image", "camera/image/keypoints", "camera/depth", "trajectory", "keyframes", "map"}
    assert {f"/world/{name}" for name in wanted} | {"/plots/inliers", "/state"} <= set(rows)
