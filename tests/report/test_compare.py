"""Several runs side by side."""

import json
import re

import pytest

from prgbd.io.files import read_json
from prgbd.report.__main__ import main
from prgbd.report.compare import settings_table
from tests.report.fake_run import make_run
from tests.report.test_ablation import override


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    runs = []
    for name, error in (("plain", 0.3), ("weighted", 0.2)):
        run = make_run(folder / name, depth_errors=(0.35, error))
        override(run, f"loss={name}")
        (run / "config.yaml").write_text(f"seed: 0\nout: {name}\nloss:\n  name: {name}\n")
        runs.append(run)
    return runs


def test_the_page_shows_both_runs_over_one_truth(pair, tmp_path, capsys):
    assert main([*map(str, pair), "--compare", "--out", str(tmp_path / "out")]) == 0
    assert "loss.name" in capsys.readouterr().out
    page = (tmp_path / "out" / "comparison.html").read_text()
    scenes = [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page)]
    assert len(scenes) == len(read_json(pair[0] / "summary.json")["sequences"])
    assert [len(scene["paths"]) for scene in scenes] == [3] * len(scenes)  # the truth and one path a run
    assert "http" not in re.sub(r"http://www.w3.org\S+", "", page)  # nothing is fetched
    for suffix in ("md", "csv", "tex"):
        text = (tmp_path / "out" / f"comparison.{suffix}").read_text()
        assert "plain" in text
        assert "weighted" in text


def test_only_settings_that_differ_are_listed(pair):
    table = settings_table(pair, ["a", "b"])
    assert table.rows == [{"option": "loss.name", "a": "plain", "b": "weighted"}]


def test_a_folder_of_runs_is_compared_as_its_runs(pair, tmp_path):
    assert main([str(pair[0].parent), "--compare", "--out", str(tmp_path)]) == 0
    assert "2 runs side by side" in (tmp_path / "comparison.html").read_text()


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_runs_are_refused_in_one_sentence(pair, tmp_path, capsys, count):
    folders = [str(tmp_path), *map(str, pair[:count])]
    assert main([*folders, "--compare", "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "needs two finished runs" in message
    assert "Traceback" not in message
    assert not (tmp_path / "out").exists()


def test_the_files_have_the_chosen_columns_and_seeds_are_joined(tmp_path, capsys):
    runs = [make_run(tmp_path / str(seed), depth_errors=(0.35, 0.2 + 0.1 * seed)) for seed in range(2)]
    for seed, run in enumerate(runs):
        override(run, f"seed={seed}")
    arguments = [*map(str, runs), "--compare", "--out", str(tmp_path / "out"), "--columns", "abs_rel,rmse"]
    assert main(arguments) == 0
    text = (tmp_path / "out" / "comparison.md").read_text()
    assert "| run | Abs Rel | RMSE |" in text
    assert "Runs, joined over seeds" in text
    assert re.search(r"\| all runs \| 0\.\d+ ± 0\.\d+ \|", text)
    assert "± 0." in (tmp_path / "out" / "comparison.html").read_text()
    capsys.readouterr()
    assert main([*arguments[:-1], "speed"]) == 2
    assert "There is no column 'speed'" in capsys.readouterr().err
