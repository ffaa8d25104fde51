"""``depth=simulated`` on the command line."""

from __future__ import annotations

import pytest

from prgbd.io.files import read_json

PARTS = ("+slam=test/sideways", "+depth=simulated", "data=test/wall")


def test_slam_runs_on_simulated_depth_and_its_depth_is_evaluated(cli) -> None:
    answer = cli(*PARTS, "depth.bias=0.1", "depth.own_sigma=0.2", "task.max_loops=0", "out=run")
    assert answer.code == 0, answer.err
    (loop,) = read_json("run/summary.json")["loops"]
    assert loop["pose"]["wall"]["tracked_frames"] == 12
    # The mean of |exp(e) - 1| for e of standard deviation 0.2; median scaling takes the bias out.
    assert loop["depth"]["abs_rel"] == pytest.approx(0.161, abs=0.005)
    assert loop["depth"]["scale_median"] == pytest.approx(1 / 1.105, abs=0.01)


def test_the_loop_says_that_there_is_nothing_to_refine(cli) -> None:
    answer = cli(*PARTS, "out=run")
    assert answer.code == 2
    assert "depth=simulated has no weights" in answer.sentence
    assert "task.max_loops=0" in answer.sentence


def test_options_have_their_meaning_in_the_help(cli) -> None:
    answer = cli("--help", "depth")
    assert answer.code == 0
    assert "scale_sigma" in answer.out
