"""The experiments of the paper's tables: what they set, and that they run on small recordings of the same layout."""

import json
from pathlib import Path

import pytest

from prgbd.cli.options import read_options
from prgbd.evaluation.settings import EvaluationSettings
from prgbd.training.objective import loss_weights
from tests.cli.test_config import composed


def experiment(*arguments):
    return composed(*arguments)


@pytest.mark.parametrize("name", ["kitti_eigen", "kitti_odometry", "tum", "ablation"])
def test_an_experiment_of_the_paper_is_its_literal_method(name):
    config = experiment(f"experiment=paper/{name}", "data.root=somewhere")
    read_options(config)
    literal = experiment("experiment=paper")
    for group in ("training", "loss", "slam", "sensing"):
        assert config[group] == literal[group]
    assert (config["training"]["learning_rate"], config["training"]["epochs"]) == (1e-6, 1)
    assert list(loss_weights(config["loss"]).values()) == [1, 1e-3, 1, 1]
    assert {term.get("residual", "absolute") for term in config["loss"].values()} == {"absolute"}
    assert config["slam"]["depth"]["follow"] is False
    assert config["slam"]["optimisation"]["focal_length_sigma"] == 0
    assert config["slam"]["features"]["align"] is False
    assert config["slam"]["keyframes"]["ratio_pseudo"] == config["slam"]["keyframes"]["ratio"] == 0.75
    assert config["task"]["max_loops"] == {"tum": 3, "ablation": 1}.get(name, 5)
    header = (Path(__file__).parents[2] / f"conf/experiment/paper/{name}.yaml").read_text()
    assert f"experiment=paper/{name}" in header


def test_training_and_test_recordings_of_the_paper_are_apart():
    for name, training, test in (("kitti_odometry", 9, 2), ("tum", 6, 2)):
        data = experiment(f"experiment=paper/{name}", "data.root=x")["data"]
        assert (len(data["sequences"]), len(data["test_sequences"])) == (training, test)
        assert not set(data["sequences"]) & set(data["test_sequences"])


def test_the_eigen_experiment_evaluates_with_the_same_protocol():
    config = experiment("experiment=paper/kitti_eigen", "task=evaluate", "data.root=x", "data.split=test_files.txt")
    protocol = read_options(config).evaluation
    assert protocol == EvaluationSettings(depth_images=None, depth_cap=80.0, depth_crop="garg")
    assert protocol.chosen_caps == (30, 40, 50, 60, 70, 80)


def test_caps_and_bins_follow_the_range():
    assert EvaluationSettings(depth_cap=10).chosen_caps == (2, 4, 6, 8, 10)
    assert EvaluationSettings(depth_cap=5).chosen_bins == (0, 1, 2, 3, 4, 5)
    assert EvaluationSettings(depth_cap=50).chosen_bins == (0, 5, 10, 15, 20, 30, 40, 50)
    given = experiment("evaluation.depth_caps=[3,5]", "evaluation.depth_bins=[]", "evaluation.median_scaling=false")
    chosen = read_options(given).evaluation
    assert chosen == EvaluationSettings(median_scaling=False, depth_caps=(3.0, 5.0), depth_bins=())
    assert (chosen.chosen_caps, chosen.chosen_bins) == ((3.0, 5.0), ())


@pytest.mark.parametrize(
    ("option", "named"),
    [
        ("evaluation.depth_cap=0", "depth_cap"),
        ("evaluation.depth_caps=[0]", "depth_caps"),
        ("evaluation.depth_caps=3", "depth_caps"),
        ("evaluation.depth_caps=[a]", "depth_caps"),
        ("evaluation.depth_bins=[3,2]", "depth_bins"),
        ("evaluation.depth_crop=round", "depth_crop"),
        ("evaluation.median_scaling=perhaps", "median_scaling"),
        ("task.baselines=[stereo]", "baselines"),
        ("task.first_teacher=posenet", "first_teacher"),
    ],
)
def test_a_wrong_option_is_named(cli, option, named):
    answer = cli("slam=orb_gtsam", "depth=monodepth2", "data=synthetic", option)
    assert answer.code == 2
    assert f".{named} is" in answer.sentence


def test_a_run_reports_caps_bins_baselines_and_test_recordings(run):
    summary = run("task.max_loops=1", "task.baselines=[mono]", "evaluation.depth_caps=[4,8]")
    depth = summary["loops"][-1]["depth"]
    assert [row["cap"] for row in depth["by_cap"]] == [4, 8]
    assert sum(row["pixels"] for row in depth["by_depth"]) > 0
    (mono,) = summary["baselines"]
    assert mono["name"] == "RGB SLAM"
    assert set(mono["pose"]) == set(summary["loops"][0]["pose"])
    for name in mono["pose"]:
        described = json.loads((Path("run/baselines/mono/slam") / name / "slam.json").read_text())
        assert described["mode"] == "mono"
    assert summary["test_sequences"] == []


def test_monocular_slam_may_be_the_first_teacher(run):
    summary = run("task.max_loops=2", "task.min_improvement=null", "task.first_teacher=mono")
    (mono,) = summary["baselines"]
    first, second = (summary["loops"][k]["training"]["keyframes"] for k in (0, 1))
    counts = {name: figures["keyframes"] for name, figures in mono["pose"].items()}
    assert first == sum(counts.values())
    assert second == sum(figures["keyframes"] for figures in summary["loops"][1]["pose"].values())


def test_the_first_teacher_learns_nothing_from_test_recordings(run, tmp_path):
    summary = run(
        *("data.root=.", "data.sequences=['00']", "data.test_sequences=['10']"),
        *("task.max_loops=1", "task.first_teacher=mono", "task.baselines=[mono]"),
    )
    (mono,) = summary["baselines"]
    assert set(mono["pose"]) == {"00", "10"}  # the one teaches, the other is compared with
    assert summary["loops"][0]["training"]["keyframes"] == mono["pose"]["00"]["keyframes"]


def test_the_time_of_a_run_holds_that_of_its_trainings(run):
    summary = run("task.max_loops=1", "task.min_improvement=null")
    parts = [loop["seconds"] for loop in summary["loops"]]
    assert summary["seconds"] == pytest.approx(sum(parts) + summary["loops"][0]["training"]["seconds"])
