"""The benchmark of cells on a small world."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import depth_sensor

    room = next(world for world in depth_sensor.WORLDS if world.name == "room")
    monkeypatch.setattr(depth_sensor, "WORLDS", (replace(room, frames=24, width=240, height=180),))
    return depth_sensor


def test_it_prints_a_row_per_cell_and_keeps_the_figures(benchmark, monkeypatch, capsys, tmp_path) -> None:
    file = tmp_path / "cells.json"
    monkeypatch.setattr(sys, "argv", ["depth_sensor.py", "--only", "room:s0.15/10-e0.2", "--json", str(file)])
    benchmark.main()
    header, rule, row, verdict = capsys.readouterr().out.splitlines()
    assert header.count("|") == rule.count("|") == row.count("|") == 5
    assert row.startswith("| 0.15 | 10 | 0.2 |")
    (cell,) = json.loads(file.read_text())
    (room,) = cell["worlds"]
    systems = room["systems"]
    assert list(systems) == ["mono", "default", *benchmark.knowing(benchmark.Cell(**cell["cell"]))]
    assert all(found["ate"] == [found["median"]] and found["tracked"] > 7 for found in systems.values())
    best = min(found["median"] for name, found in systems.items() if name != "default")
    assert room["ratio"] == pytest.approx(systems["default"]["median"] / best)
    assert verdict.startswith(f"{int(room['ratio'] <= benchmark.LIMIT)} of 1 within 1.15")


def test_the_cells_are_those_of_the_grid(benchmark) -> None:
    few, everything = benchmark.cells(everything=False), benchmark.cells(everything=True)
    assert len(set(few)) == 13
    assert len(set(everything)) == 30  # without a scale error there is no length
    assert set(few) <= set(everything)


def test_a_cell_that_is_not_there_is_named(benchmark, monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", ["depth_sensor.py", "--only", "cellar"])
    with pytest.raises(SystemExit):
        benchmark.main()
    assert "no cell is called cellar; one is room:s0-e0.2" in capsys.readouterr().err
