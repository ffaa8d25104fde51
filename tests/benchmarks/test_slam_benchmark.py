"""The SLAM benchmark as a user runs it, on a small synthetic world."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import prgbd

ROOT = Path(__file__).parents[2]
WORLD = ["data.scene=indoor", "data.frames=14", "data.width=160", "data.height=120", "data.sensor_depth=true"]


def benchmark(*arguments, cwd):
    command = [sys.executable, str(ROOT / "benchmarks" / "slam.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=None)


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark")
    options = {pair.split("=")[0].removeprefix("data."): pair.split("=")[1] for pair in WORLD}
    sequence = prgbd.make_data("synthetic", scene="indoor", frames=14, width=160, height=120, sensor_depth=True)
    assert options["frames"] == str(len(sequence))
    rows = [
        f"{i / 10} {' '.join(str(v) for v in pose[:3, 3] + 0.01 * (i % 2))} 0 0 0 1"
        for i, pose in enumerate(sequence.poses)
        if i % 2 == 0
    ]
    (folder / "other.tum").write_text("\n".join(rows) + "\n")
    run = benchmark(
        "synthetic", "mode=rgbd", *WORLD, "--seeds", "2", "--per", "5", "--compare", "other.tum",
        "--compare", "shifted=other.tum", "--compare-fps", "10", "--read-ahead", "1",
        "json=figures.json", "png=picture.png", cwd=folder,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return folder, run.stdout


def test_it_prints_each_seed_the_median_and_the_blocks(printed):
    folder, text = printed
    assert "seed 0:" in text
    assert "seed 1:" in text
    assert "frames    10-13" in text
    assert (folder / "picture.png").stat().st_size > 10_000


def test_the_figures_are_those_of_a_good_run(printed):
    found = json.loads((printed[0] / "figures.json").read_text())
    assert len(found["runs"]) == 2
    assert found["runs"][0]["tracked"] == 14
    assert found["runs"][0]["ate_sim3_m"] < 0.05
    assert found["runs"][0]["ate_sim3_m"] == found["runs"][1]["ate_sim3_m"]
    assert found["runs"][0]["fps"] > found["runs"][0]["fps_with_finish"] > 0


def test_another_system_stands_beside_ours_on_the_frames_that_both_have(printed):
    row = next(line for line in printed[1].splitlines() if line.strip().startswith("other"))
    name, frames, own, common, *errors = row.split()
    assert (name, frames, common) == ("other", "7", "7")
    assert float(own) < 0.01
    assert np.isfinite([float(e) for e in errors]).all()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["nowhere"], "nowhere"),
        (["synthetic", "mode=sonar"], "sonar"),
        (["synthetic", "data.frames=5", "--frames", "9:12"], "--frames"),
        (["synthetic", "speed"], "speed"),
        (["synthetic", "lidar.range=3"], "lidar.range"),
        (["synthetic", *WORLD, "mode=rgbd", "--compare", "missing.tum"], "missing.tum"),
        (["synthetic", *WORLD, "mode=rgbd", "--compare", "prgbd=missing.tum"], "prgbd"),
        (["synthetic", *WORLD, "mdoe=rgbd"], "mdoe"),
        (["synthetic", *WORLD, "mode=rgbd", "baseline=wide"], "baseline"),
        (["synthetic", *WORLD, "mode=stereo"], "right images"),
        (["synthetic", "--seeds", "0"], "--seeds"),
    ],
)
def test_nonsense_is_one_sentence(arguments, expected, tmp_path):
    run = benchmark(*arguments, cwd=tmp_path)
    assert run.returncode == 2
    assert expected in run.stderr
    assert "Traceback" not in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1


def test_a_name_before_the_file_is_printed_instead_of_its_own(printed):
    rows = [line.split() for line in printed[1].splitlines()]
    own = next(row for row in rows if row[:1] == ["other"])
    assert next(row for row in rows if row[:1] == ["shifted"])[1:] == own[1:]


def test_frames_keep_their_numbers_when_only_some_are_used(tmp_path):
    run = benchmark("synthetic", "mode=rgbd", *WORLD, "frames=4:14:2", "per=3", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert "tracked frames  5 of 5" in run.stdout
    assert "frames     4-8" in run.stdout
    assert "frames    10-12" in run.stdout


def test_a_run_that_found_no_pose_is_the_worst_and_never_the_median(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    slam = importlib.import_module("slam")
    errors = (None, 0.3, 0.1)
    assert slam.middle_of([{"ate_sim3_m": error} for error in errors]) == 1
    assert slam.middle_of([{"ate_sim3_m": None}, {"ate_sim3_m": 0.1}]) == 1
