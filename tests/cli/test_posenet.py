"""``slam=posenet`` from the command line: figures, files and a report without a single map point."""

import json
from pathlib import Path

import pytest
import torch

import prgbd


@pytest.mark.slow
@pytest.mark.usefixtures("real_report")
def test_the_baseline_runs_and_is_reported(cli, tmp_path):
    network = prgbd.make_depth("monodepth2", height=64, width=96)
    with torch.no_grad():
        network.pose_network().decoder.net[3].bias += torch.linspace(0.5, 1.5, 12)
    network.save_weights(tmp_path / "weights")
    world = ("data=synthetic", "data.sequences=[street-0]", "data.frames=8", "data.width=96", "data.height=64")
    answer = cli("slam=posenet", f"slam.weights={tmp_path / 'weights'}", *world, "task=slam", "out=run")
    assert answer.code == 0, answer.err
    summary = json.loads(Path("run/summary.json").read_text())
    figures = summary["loops"][0]["pose"]["street-0"]
    assert (figures["tracked_frames"], figures["points"], figures["keyframes"]) == (8, 0, 8)
    assert figures["ate_rmse"] > 0
    assert Path("run/report.html").is_file()


def test_missing_weights_are_named(cli):
    answer = cli("slam=posenet", "data=synthetic", "data.frames=4", "task=slam", "out=run")
    assert "slam.weights" in answer.sentence


def test_a_baseline_without_a_pose_network_is_named_before_anything_runs(cli):
    answer = cli("slam=orb_gtsam", "depth=monodepth2", "data=synthetic", "task.baselines=[mono,posenet]", "out=run")
    assert "task.baselines=[posenet]" in answer.sentence
    assert "hold no pose network" in answer.sentence
    assert not Path("run").exists()
    answer = cli(
        *("slam=orb_gtsam", "depth=monodepth2", "depth.weights=null", "data=synthetic"),
        *("task.baselines=[posenet]", "out=run"),
    )
    assert "task.baselines=[posenet]" in answer.sentence
