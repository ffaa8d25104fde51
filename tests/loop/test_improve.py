"""``prgbd.improve``: the loop from Python."""

import contextlib
import json
import tempfile

import pytest
import torch

import prgbd
from prgbd.core.errors import ConfigError
from prgbd.loop.monitor import SilentMonitor
from tests.cli.conftest import FAKES
from tests.conftest import ROOT
from tests.loop import fakes
from tests.loop.fakes import Sideways, Tiny, Wall
from tests.training.spies import Counting

ALL_LOOPS = {"max_loops": 2, "task": {"min_improvement": None}, "training": {"learning_rate": 1e-2}}


@pytest.fixture(autouse=True)
def _small(monkeypatch, tmp_path):
    fakes.register()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("prgbd.report.page.write_report", lambda run: None)
    monkeypatch.setattr(Counting, "trainings", 0)


def improve(data=None, **options):
    torch.manual_seed(0)
    chosen = {"depth": Tiny, "slam": Sideways, "out": "run", "monitor": SilentMonitor(), **ALL_LOOPS, **options}
    return prgbd.improve(data or Wall(), **chosen)


def without_times(value):
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if k not in ("seconds", "fps")}
    return [without_times(v) for v in value] if isinstance(value, list) else value


def test_objects_become_a_better_network_a_summary_and_a_report(tmp_path):
    network, wall = Tiny(), Wall()
    result = prgbd.improve(wall, depth=network, slam=Sideways, out="run", callbacks=[Counting()], **ALL_LOOPS)
    assert result.depth is network
    assert result.depth.predict(wall.frame(0).image).shape == (64, 96)
    best = torch.load(result.folder / "weights" / "model.pth")
    assert all(torch.equal(value, best[name]) for name, value in network.state_dict().items())
    assert result.summary == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert result.report.name == "report.html"
    assert (result.folder / "metrics.csv").is_file()
    assert Counting.trainings == 2
    assert [loop["loop"] for loop in result.loops] == [0, 1, 2]
    assert result.loops[0]["held_out_loss"] < result.summary["loops"][0]["training"]["held_out_before"]
    assert result.loops[0]["tracked"] == 1.0
    assert result.loops[2]["held_out_loss"] is None


def test_it_shows_what_every_loop_reached():
    lines = repr(improve()).splitlines()
    assert lines[0] == "Improvement of Tiny on wall"
    assert lines[1].startswith("  loop 0  pRGBD-Initial")
    assert "ATE 0." in lines[1]
    assert "Abs Rel 0." in lines[1]
    assert lines[3].endswith("(best)")
    assert lines[-1].endswith("report.html")


def test_loss_terms_augmentations_and_criterion_are_chosen_by_name():
    result = improve(
        loss={"photometric": 0, "depth_transfer": {"weight": 0.1, "residual": "log"}},
        augmentation={"jitter": {"strength": 0.5}},
        task={"criterion": "both"},
        max_loops=1,
    )
    header, first = (result.folder / "loops/00/training/losses.csv").read_text().splitlines()[:2]
    assert header == "step,epoch,total,photometric,smoothness,depth_consistency,depth_transfer"
    assert first.split(",")[3] == ""
    assert all(first.split(",")[4:])


def test_every_step_is_printed_unless_somebody_else_watches(capsys):
    improve(monitor=None, max_loops=0)
    assert "Loop 0: pRGBD-Initial" in capsys.readouterr().out


def test_the_figures_are_those_of_the_command_line(capfd):
    from prgbd.__main__ import main

    result = improve("test/wall", depth="test/tiny", slam="test/sideways", out="python", max_loops=2, task={})
    assert main([*FAKES, "out=shell", "task.max_loops=2"]) == 0
    shell = json.loads((result.folder.parent / "shell" / "summary.json").read_text())
    assert without_times(result.summary) == without_times(shell)


def test_plugins_by_id_with_options_beside_objects():
    result = improve(
        [("test/wall", {"frames": 14}), Wall("10")],
        test=("test/wall", {"root": ".", "sequences": ["00"]}),
        depth=("test/tiny", {"start": 3.5, "wrappers": ["flip_averaged"]}),
        slam=("test/sideways", {"every": 3}),
        max_loops=1,
    )
    assert result.summary["sequences"] == ["wall", "10", "00"]
    assert result.summary["test_sequences"] == ["00"]
    assert (result.summary["slam"], result.summary["depth"]) == ("test/sideways", "test/tiny")
    assert result.summary["loops"][0]["pose"]["wall"]["frames"] == 14
    config = (result.folder / "config.yaml").read_text()
    assert "start: 3.5" in config
    assert "every: 3" in config


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"slam": Sideways()}, ["Sideways", "made already", "class"]),
        ({"slam": "orb_gtsm"}, ["'orb_gtsm'", "'orb_gtsam'"]),
        ({"slam": Tiny}, ["slam", "GeometricSLAM"]),
        ({"depth": "monodepth"}, ["'monodepth2'"]),
        ({"depth": ("test/tiny", {"strt": 1.0})}, ["strt", "start"]),
        ({"depth": 3}, ["depth is 3", "DepthEstimator"]),
        ({"data": [3]}, ["data holds 3"]),
        ({"data": [Wall(), Wall()]}, ["'wall'", "twice"]),
        ({"data": Wall(frames=1)}, ["'wall'", "1 frame"]),
        ({"loss": {"fotometric": 1}}, ["'photometric'"]),
        ({"training": {"lr": 1e-2}}, ["training.lr", "training.learning_rate"]),
        ({"task": {"patience": -1}}, ["task.patience"]),
        ({"trainer": {"devices": "x"}}, ["trainer", "devices"]),
        ({"evaluation": {"depth_test": {"split": "test.txt"}}}, ["evaluation.depth_test", "test="]),
        ({"callbacks": ["early"]}, ["'early'", "Callback"]),
    ],
    ids=lambda value: "" if isinstance(value, list) else next(iter(value)),
)
def test_what_cannot_be_is_said_before_a_run_begins(options, words, tmp_path):
    with pytest.raises(prgbd.PrgbdError) as caught:
        improve(**options)
    for word in words:
        assert word in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_a_run_that_was_stopped_goes_on(monkeypatch):
    whole = improve(out="whole")
    monkeypatch.setattr(Sideways, "tracked_in_process", 0)
    plain = Sideways.track

    def stopping(self, frame):
        if Sideways.tracked_in_process == 20:
            raise KeyboardInterrupt
        return plain(self, frame)

    with monkeypatch.context() as patched:
        patched.setattr(Sideways, "track", stopping)
        with pytest.raises(KeyboardInterrupt):
            improve()
    with pytest.raises(ConfigError, match=r"other options \(training\)"):
        improve(resume=True, training={"learning_rate": 1e-3})
    with pytest.raises(ConfigError, match="holds a run already"):
        improve()
    assert without_times(improve(resume=True).summary) == without_times(whole.summary)


def test_the_notebook_runs(monkeypatch, capsys):
    """On the real plug-ins; it imports nothing but prgbd."""
    monkeypatch.undo()
    cells = json.loads((ROOT / "examples" / "improve.ipynb").read_text())["cells"]
    names: dict = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for cell in cells:
            if cell["cell_type"] == "code":
                assert not cell["outputs"]
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
        assert names["result"].report.is_file()
    assert "lightning_logs" in capsys.readouterr().out
    assert names["result"].loops[0]["tracked"] == 1.0
