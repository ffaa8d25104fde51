"""The depth benchmark as a user runs it, on a small network."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SMALL = ["--size", "96x64", "--batch", "2", "--frames", "3", "--rounds", "2", "--threads", "1"]


def benchmark(*arguments, cwd):
    command = [sys.executable, str(ROOT / "benchmarks" / "depth.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd)


def test_ours_is_the_plain_program_s_depth_and_loss(tmp_path):
    done = benchmark(*SMALL, "--json", "depth.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "depth.json").read_text())
    plain, exact, half = found["inference"]
    assert plain["depth_difference"]["max"] == 0
    assert exact["depth_difference"]["max"] < 1e-4
    assert half["depth_difference"]["mean"] < 0.01
    plain, exact, half = found["training"]
    assert len(plain["loss"]) == 2
    assert plain["loss"][0] != plain["loss"][1]
    assert exact["loss_difference"] < 1e-4
    assert half["loss_difference"] < 0.02
    assert all(
        row["images_per_s"] > 0 and row["ratio"] > 0 for rows in (found["inference"], found["training"]) for row in rows
    )
    for words in ("plain float32", "ours, exact", "loss differs by", "per 1000 images"):
        assert words in done.stdout


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [(["--size", "640"], "WIDTHxHEIGHT"), (["--batch", "0"], "--batch is 0")],
)
def test_wrong_arguments_are_told_in_a_sentence(arguments, sentence, tmp_path):
    done = benchmark(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
