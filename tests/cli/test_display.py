"""What the terminal shows while something runs."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from prgbd.cli import display
from prgbd.cli.display import Display


def on_a_terminal(monkeypatch, columns: int) -> tuple[Display, io.StringIO]:
    screen = io.StringIO()
    shown = Display(bars=True)
    shown.console = Console(file=screen, force_terminal=True, width=columns, color_system="standard")
    return shown, screen


def last_line(screen: io.StringIO) -> str:
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue())
    return next(line for line in reversed(plain.replace("\r", "\n").split("\n")) if "137/500" in line).rstrip()


@pytest.mark.parametrize(
    ("columns", "wanted"),
    [
        (140, ["SLAM on a-recording-with-a-long-name", "ok  42 keyframes  5,310 points  1 map"]),
        (80, ["SLAM on a-re…h-a-long-name", "ok  42 kf  5,310 pts  1 map"]),
    ],
)
def test_one_line_says_all_at_a_glance(monkeypatch, columns, wanted):
    shown, screen = on_a_terminal(monkeypatch, columns)
    with shown.stage("SLAM on a-recording-with-a-long-name", 500) as progress:
        for _ in range(137):
            progress.advance(state="ok", keyframes=42, points=5310, maps=1)
        progress._progress.refresh()
        line = last_line(screen)
        assert all(part in line for part in wanted), line
        assert re.search(r"137/500 +[\d.]+/s +\d+:\d\d", line), line
        assert len(line) <= columns
        progress.advance(0, state="lost")
        progress._progress.refresh()
        assert "\x1b[31mlost" in screen.getvalue()  # red


def test_a_pipe_gets_a_line_now_and_then(monkeypatch, capsys):
    clock = iter(range(0, 100000, 10))
    monkeypatch.setattr(display.time, "monotonic", lambda: float(next(clock)))
    with Display(bars=False).stage("SLAM on street", 10) as progress:
        for _ in range(10):
            progress.advance(state="ok", keyframes=1, points=5310, loss="0.5")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "SLAM on street: 4/10, 0.1/s, 1:00 left, ok, 1 keyframe, 5,310 points, loss 0.5"
    assert [line.split(":")[1].split(",")[0] for line in lines[:-1]] == [" 4/10", " 8/10"]
    assert lines[-1].startswith("SLAM on street: 10 in ")


@pytest.mark.parametrize(("seconds", "clock"), [(7.4, "0:07"), (754, "12:34"), (3723, "1:02:03")])
def test_times_read_like_a_clock(seconds, clock):
    assert display._clock(seconds) == clock


@pytest.mark.parametrize("bars", [True, False])
def test_what_is_left_out_does_not_slow_the_rate(monkeypatch, capsys, bars):
    now = [0.0]
    monkeypatch.setattr(display.time, "monotonic", lambda: now[0])
    shown, screen = on_a_terminal(monkeypatch, 140)
    shown.bars = bars
    with shown.stage("SLAM on street", 3) as progress:
        now[0] += 60
        progress.leave_out(59.0)  # the first frame waited for a compiler
        progress.advance(state="ok")
        for _ in range(2):
            now[0] += 1
            progress.advance(state="ok")
    assert "SLAM on street: 3 in 3.0 s, 1.0/s" in screen.getvalue()
