"""``depth.wrappers`` on the command line."""

from pathlib import Path

import pytest


def test_the_loop_runs_through_wrappers(run):
    summary = run("task.max_loops=1", "depth.wrappers=[flip_averaged,{clipped:{farthest:4.5}}]")
    assert summary["loops"][0]["depth_max"]["wall"] <= 4.5001
    assert len(summary["loops"]) == 2


def test_other_wrappers_do_not_share_predicted_depth(cli):
    parts = ("+slam=test/sideways", "+depth=test/tiny", "data=test/wall", "task=slam", "sensing.cache=cache")
    for number, farthest in enumerate((4.5, 3.5)):
        answer = cli(*parts, f"depth.wrappers=[{{clipped:{{farthest:{farthest}}}}}]", f"out=run{number}")
        assert answer.code == 0, answer.err
    assert len(list(Path("cache").rglob("*.npy"))) == 2


@pytest.mark.parametrize("value", ["[flipped]", "flip_averaged"])
def test_a_wrong_wrapper_is_refused_before_anything_runs(cli, value):
    answer = cli("+slam=test/sideways", "+depth=test/tiny", "data=test/wall", f"depth.wrappers={value}", "out=run")
    assert answer.code == 2
    assert "wrapper" in answer.sentence
