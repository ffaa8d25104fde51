"""Whole runs of every task on the small plug-ins."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from omegaconf import OmegaConf

from tests.cli.conftest import FAKES
from tests.loop.fakes import WALL, Sideways, Wall

EVERY_LOOP = {
    "slam/wall/result.npz",
    "slam/wall/trajectory.tum",
    "slam/wall/trajectory.kitti",
    "slam/wall/keyframes.tum",
    "slam/wall/keyframes.kitti",
    "slam/wall/online.tum",
    "slam/wall/map.ply",
    "slam/wall/slam.json",
    "depth/samples.npz",
}


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_the_loop_leaves_the_whole_folder(run, real_report):
    summary = run("task.max_loops=2", "seed=3", "training.epochs=1", "task.criterion=held_out")
    assert {"config.yaml", "summary.json", "metrics.csv", "run.log", "report.html", "truth/wall.tum"} <= files(
        Path("run")
    )
    assert files(Path("run/weights")) == {"model.pth"}
    for loop in range(3):
        learnt = {"training/losses.csv", "weights/model.pth"} if loop < 2 else set()
        assert files(Path(f"run/loops/{loop:02d}")) == EVERY_LOOP | learnt
    assert not Path("run/cache").exists()
    config = OmegaConf.load("run/config.yaml")
    assert config.seed == 3
    assert config.task.max_loops == 2

    names = [loop["name"] for loop in summary["loops"]]
    assert names == ["pRGBD-Initial", "pRGBD-Refined", "pRGBD-Refined (2)"]
    assert summary["stop"]["best_loop"] == 2
    assert (summary["slam"], summary["depth"], summary["data"]) == ("test/sideways", "test/tiny", "test/wall")
    first = summary["loops"][0]
    assert first["pose"]["wall"]["tracked_frames"] == first["pose"]["wall"]["frames"] == 12
    assert first["pose"]["wall"]["alignment"] == "sim3"
    assert 0 < first["pose"]["wall"]["ate_rmse"] < 0.05
    assert first["depth"]["images"] == 12
    assert first["baseline"]["wall"] == pytest.approx(0.54 / 80 * first["depth_max"]["wall"])
    assert first["pose"]["wall"]["baseline"] == first["baseline"]["wall"]
    losses = list(csv.DictReader(Path("run/loops/00/training/losses.csv").read_text().splitlines()))
    assert list(losses[0]) == [
        "step", "epoch", "total", "photometric", "smoothness", "depth_consistency", "depth_transfer"
    ]  # fmt: skip
    for loop in summary["loops"][:2]:
        assert loop["training"]["held_out_after"] < loop["training"]["held_out_before"]
    # The refined network was used: its depth is nearer to SLAM's points, which lie on the wall.
    samples = [np.load(f"run/loops/{loop:02d}/depth/samples.npz") for loop in range(3)]
    distance = [abs(float(np.median(s["depth"])) - WALL) for s in samples]
    assert distance[0] > distance[1] > distance[2]
    assert np.array_equal(samples[0]["frame_index"], samples[2]["frame_index"])


def test_a_loop_that_slam_calls_worse_is_rolled_back(run, monkeypatch, real_report):
    """The refinement's own loss falls, yet nothing that SLAM made of the network got better."""
    from prgbd.loop import pose_refinement

    real = pose_refinement.evidence

    def spoilt(result, sensor, gap):
        found = real(result, sensor, gap)
        spoilt.calls += 1
        worse = 1.0 if spoilt.calls < 3 else 2.0
        return {**found, "photometric": {k: worse * v for k, v in found["photometric"].items()}}

    spoilt.calls = 0
    monkeypatch.setattr(pose_refinement, "evidence", spoilt)
    summary = run("task.max_loops=3", "task.criterion=both", "data.frames=20")
    assert [loop.get("rolled_back", False) for loop in summary["loops"]] == [False, False, True]
    assert summary["stop"]["best_loop"] == 1
    assert "Loop 2 is rolled back" in summary["stop"]["reason"]
    assert summary["loops"][2]["criterion"]["compared_with"] == 1
    assert summary["loops"][2]["criterion"]["index"] > 1
    assert Path("run/weights/model.pth").read_bytes() == Path("run/loops/00/weights/model.pth").read_bytes()
    page = Path("run/report.html").read_text()
    assert "Over 1 loop the" in page
    assert "Loop 2 is rolled back" in page
    assert "pRGBD-Refined (2), rolled back" in page


def test_no_improvement_stops_and_goes_back_to_the_better_weights(run):
    import torch

    summary = run("task.min_improvement=0.999", "task.criterion=held_out")
    assert [loop["loop"] for loop in summary["loops"]] == [0]
    assert summary["stop"]["best_loop"] == 0
    assert "No improvement" in summary["stop"]["reason"]
    kept, refined = (torch.load(f"run/{path}/model.pth") for path in ("weights", "loops/00/weights"))
    assert float(kept["bias"]) == pytest.approx(np.log(3.0))
    assert float(refined["bias"]) != float(kept["bias"])


def test_same_seed_same_result(run, monkeypatch, tmp_path):
    first = run("task.max_loops=1")
    (tmp_path / "again").mkdir()
    monkeypatch.chdir(tmp_path / "again")
    second = run("task.max_loops=1")
    assert without_times(first) == without_times(second)


def without_times(value):
    """The summary without what the clock and the place decide."""
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if k not in ("seconds", "fps")}
    return [without_times(v) for v in value] if isinstance(value, list) else value


def test_test_sequences_are_evaluated_but_not_learnt_from(run):
    summary = run("data.root=.", "data.sequences=[00]", "data.test_sequences=[10]", "task.max_loops=1")
    assert summary["sequences"] == ["00", "10"]
    assert set(summary["loops"][1]["pose"]) == {"00", "10"}
    assert summary["loops"][0]["training"]["keyframes"] == 6
    assert summary["loops"][0]["depth"]["images"] == 12


@pytest.mark.parametrize(
    ("arguments", "name", "baseline"),
    [
        (["slam.mode=mono"], "RGB", None),
        (["data.sensor=true"], "RGB-D", 0.08),
        (["data.sensor=true", "slam.mode=rgbd", "+depth=test/tiny", "slam.baseline=0.2"], "RGB-D", 0.2),
        (["+depth=test/tiny", "slam.baseline=0.3"], "pRGBD-Initial", 0.3),
    ],
)
def test_slam_alone_uses_the_depth_that_was_asked_for(run, arguments, name, baseline):
    summary = run("task=slam", *arguments, fakes=("slam=test/sideways", "data=test/wall"))
    (loop,) = summary["loops"]
    assert loop["name"] == name
    assert loop["pose"]["wall"]["baseline"] == baseline
    assert loop["pose"]["wall"]["mode"] == ("mono" if name == "RGB" else "rgbd")
    assert (loop["depth"] is not None) == (name == "pRGBD-Initial")
    assert summary["depth"] == ("test/tiny" if name == "pRGBD-Initial" else "")


def test_results_are_exported_in_the_formats_that_were_chosen(run, cli):
    run("task=slam", "slam.mode=mono", "export=[tum,colmap_images]")
    found = files(Path("run/loops/00/slam/wall"))
    sparse = {f"colmap/sparse/0/{name}.txt" for name in ("cameras", "images", "points3D")}
    images = {path for path in found if path.startswith("colmap/images/")}
    assert found - images == {"result.npz", "slam.json", "trajectory.tum", "keyframes.tum", "online.tum"} | sparse
    assert "colmap/images/000000.png" in images
    assert "did you mean 'kitti'" in cli(*FAKES, "task=slam", "export=[kiti]", "out=wrong").sentence


def test_maps_are_kept_in_the_run_and_taken_from_a_file(run, cli, monkeypatch):
    calls = []
    monkeypatch.setattr(Sideways, "save_map", lambda self, path: calls.append(("save", Path(path))))
    monkeypatch.setattr(Sideways, "load_map", lambda self, path: calls.append(("load", Path(path))))
    Path("old.npz").touch()
    mono = ("slam=test/sideways", "data=test/wall", "slam.mode=mono")
    run("task=slam", "+slam.save_map=true", "+slam.load_map=old.npz", fakes=mono)
    assert calls == [("load", Path("old.npz")), ("save", Path("run/maps/wall.npz").resolve())]
    Path("run").rename("first")
    calls.clear()
    run("task=slam", "+slam.save_map=new.npz")  # on the network's depth
    assert calls == [("save", Path("new.npz"))]


def test_every_loop_can_be_recorded_for_rerun(run):
    pytest.importorskip("rerun")
    run("task.max_loops=1", "viz=rerun")
    assert files(Path("run/viz")) == {"00-wall.rrd", "01-wall.rrd"}


def test_maps_that_cannot_be_are_named(cli):
    def sentence(*arguments):
        answer = cli(*FAKES, *arguments, "out=wrong")
        assert answer.code == 2
        return answer.sentence

    assert "Sideways cannot save its map" in sentence("task=slam", "+slam.save_map=true")
    Path("wrong").rename("stopped")
    assert "no file absent.npz" in sentence("task=slam", "+slam.load_map=absent.npz")
    assert "add task=slam" in sentence("+slam.save_map=true")
    assert "slam.save_map=true" in sentence(
        "task=slam", "+slam.save_map=one.npz", "data.root=.", "data.sequences=[00,10]"
    )


def test_adaptive_baseline_by_percentile(run):
    everything = run("task=slam")
    assert everything["loops"][0]["depth_max"]["wall"] > 3.0
    Path("run").rename("first")
    median = run("task=slam", "sensing.baseline_percentile=50")
    assert median["loops"][0]["depth_max"]["wall"] < everything["loops"][0]["depth_max"]["wall"]


def test_depth_writes_png_preview_and_numbers(run):
    summary = run("task=depth", "task.npz=true", "task.every=5")
    folder = Path("run/depth/wall")
    assert files(folder / "png") == {"000000.png", "000005.png", "000010.png"}
    assert files(folder / "preview") == {"000000.jpg", "000005.jpg", "000010.jpg"}
    exact = np.load(folder / "npz" / "000005.npz")["depth"]
    stored = cv2.imread(str(folder / "png" / "000005.png"), cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint16
    assert np.abs(stored / 256 - exact).max() <= 0.5 / 256 + 1e-6
    assert json.loads((folder / "depth.json").read_text())["png_scale"] == 256
    assert summary["loops"][0]["depth"]["abs_rel"] < 0.05  # after median scaling


def test_evaluate_a_network_and_a_trajectory(run):
    run("task=slam", "slam.mode=mono", fakes=("slam=test/sideways", "data=test/wall"))
    Path("run").rename("slam")
    for name in ("trajectory.tum", "trajectory.kitti"):
        file = f"slam/loops/00/slam/wall/{name}"
        summary = run("task=evaluate", f"task.trajectory={file}", fakes=("depth=test/tiny", "data=test/wall"))
        pose = summary["loops"][0]["pose"]["wall"]
        before = json.loads(Path("slam/summary.json").read_text())["loops"][0]["pose"]["wall"]
        assert pose["ate_rmse"] == pytest.approx(before["ate_rmse"], rel=1e-3)
        assert summary["loops"][0]["depth"]["images"] == 12
        Path("run").rename(f"evaluated-{name}")


def test_a_trajectory_on_another_clock_is_evaluated_and_said_or_refused(run, cli):
    sequence = Wall()
    rows = [(t, *pose[:3, 3], 0, 0, 0, 1) for t, pose in zip(sequence.timestamps, sequence.poses, strict=True)]
    lines = [" ".join(map(str, (round((1e9 + row[0]) * 1e9), *row[1:]))) for row in rows]
    Path("ns.tum").write_text("\n".join(lines))
    pose = run("task=evaluate", "task.trajectory=ns.tum", fakes=("data=test/wall",))["loops"][0]["pose"]["wall"]
    assert pose["pairs"] == len(sequence)
    assert pose["ate_rmse"] == pytest.approx(0, abs=1e-6)
    assert "look like nanoseconds since 1970" in pose["doubts"][0]
    Path("far.tum").write_text("\n".join(f"{t + 5000} 0 0 0 0 0 0 1" for t in sequence.timestamps))
    answer = cli("task=evaluate", "task.trajectory=far.tum", "data=test/wall", "out=far")
    assert answer.code == 2
    assert "do not meet" in answer.sentence


def test_an_existing_run_is_not_overwritten(run, cli):
    before = run("task=slam")
    answer = cli(*FAKES, "task=slam", "out=run")
    assert answer.code == 2
    assert "resume=run" in answer.sentence.replace(str(Path.cwd()) + "/", "")
    assert json.loads(Path("run/summary.json").read_text()) == before


def test_multirun_gives_one_table_and_goes_on_after_a_failure(cli):
    answer = cli("-m", *FAKES, "out=sweep", "task.max_loops=1", "loss=all,no_photometric", "seed=0,-1")
    assert answer.code == 2
    assert sorted(p.parent.name for p in Path("sweep").glob("*/summary.json")) == ["0", "2"]
    table = Path("sweep/ablation.md").read_text()
    assert "loss=no_photometric" in table
    assert "seed is -1" in answer.err
    assert "2 of the runs failed" in answer.err


def test_help_names_choices_and_examples(cli):
    answer = cli("--help")
    assert answer.code == 0
    for word in ("orb_gtsam", "monodepth2", "test/tiny", "no_depth_transfer", "resume=last", "slam.mode"):
        assert word in answer.out


def test_printing_the_configuration_runs_nothing(cli):
    answer = cli(*FAKES, "--cfg", "job")
    assert answer.code == 0
    assert "id: test/tiny" in answer.out
    assert not list(Path().iterdir())


def test_warnings_of_the_parts_are_shown_and_logged(cli, monkeypatch):
    import logging

    from tests.loop.fakes import Sideways

    finish = Sideways.finish

    def warns(self):
        logging.getLogger("prgbd.plugins.slam").warning("compiling [once]")
        logging.getLogger("lightning.pytorch").warning("buy more")
        return finish(self)

    monkeypatch.setattr(Sideways, "finish", warns)
    answer = cli(*FAKES, "task=slam", "out=run")
    assert "compiling [once]" in answer.out
    assert "compiling [once]" in Path("run/run.log").read_text()
    assert "buy more" not in answer.out + answer.err


def test_pretraining_leaves_weights_that_the_loop_can_start_from(run, cli):
    options = ("task=pretrain", "pretraining.epochs=2", "pretraining.learning_rate=1e-2", "data.frames=20")
    summary = run(*options, fakes=("depth=test/pose", "data=test/wall"))
    assert files(Path("run/weights")) == {"model.pth"}
    (loop,) = summary["loops"]
    assert loop["training"]["held_out_after"] < loop["training"]["held_out_before"]
    assert loop["depth"]["images"] == 20
    answer = cli("slam=test/sideways", "depth=test/pose", "depth.weights=run/weights", "data=test/wall", "task=slam")
    assert answer.code == 0, answer.err
    refused = cli("depth=test/tiny", "data=test/wall", "task=pretrain", "out=refused")
    assert "pose network" in refused.sentence


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("task=depth", "depth=test/tiny"), "there is no ground truth to measure it against"),
        (("task=pretrain", "depth=test/pose", "pretraining.epochs=1", "pretraining.batch_size=2"), "Pre-training"),
        (("task=slam", "slam=test/sideways", "slam.mode=mono"), "There is no ground truth"),
    ],
)
def test_every_task_reports_on_images_without_truth(cli, tmp_path, real_report, arguments, words):
    noise = np.random.default_rng(0).integers(0, 256, (8, 64, 96, 3), np.uint8)
    (tmp_path / "images").mkdir()
    for i, image in enumerate(noise):
        cv2.imwrite(f"images/{i:03d}.png", image)
    answer = cli("data=images", "data.root=images", "data.fov=70", "out=run", *arguments)
    assert answer.code == 0, answer.err
    assert words in Path("run/report.html").read_text()
