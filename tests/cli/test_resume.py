"""Runs that were killed, and go on."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.cli.conftest import FAKES
from tests.cli.test_tasks import without_times

ROOT = Path(__file__).parents[2]
PROGRAM = (
    "import sys; from tests.loop import fakes; fakes.register(); from prgbd.__main__ import main; sys.exit(main())"
)


def killed_run(*arguments: str) -> None:
    """Run in another process, which kills itself (SIGKILL) at the frame that ``slam.die_at`` says."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], env=environment, capture_output=True, text=True
    )
    assert process.returncode == -signal.SIGKILL, process.stderr


def test_killed_in_the_second_loop_and_resumed_ends_as_if_it_had_not_been(cli, monkeypatch, tmp_path):
    from tests.loop.fakes import Sideways

    shared = (*FAKES, "task.max_loops=2", "slam.die_at=18")
    killed_run(*shared, "out=killed")
    assert Path("killed/steps/loops/00/refine.json").is_file()
    assert not Path("killed/steps/loops/01/slam/wall.json").exists()
    refined = Path("killed/loops/00/weights/model.pth").stat().st_mtime_ns
    Path("killed/loops/01/slam/.wall.1-0123abcd.tmp").mkdir(parents=True)  # what a kill in the midst of writing leaves

    # In this process, frames are counted anew, so that 18 is not reached before the end.
    monkeypatch.setattr(Sideways, "tracked_in_process", -1000)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    answer = cli("resume=../killed")
    assert answer.code == 0, answer.err
    monkeypatch.chdir(tmp_path)
    assert not Path("killed/loops/01/slam/.wall.1-0123abcd.tmp").exists()
    assert Path("killed/loops/00/weights/model.pth").stat().st_mtime_ns == refined

    assert cli(*shared, "out=whole").code == 0
    summaries = [json.loads(Path(f"{run}/summary.json").read_text()) for run in ("killed", "whole")]
    assert without_times(summaries[0]) == without_times(summaries[1])
    weights = [Path(f"{run}/weights/model.pth").read_bytes() for run in ("killed", "whole")]
    assert weights[0] == weights[1]


MORTAL = ("+slam=test/sideways", "+depth=test/mortal", "data=test/wall", "data.frames=26")
LOOPS = ("task.max_loops=2", "task.min_improvement=null")
LEARNING = ("training.learning_rate=1e-2", "training.batch_size=1", "training.epochs=2", "training.augment=true")
STEPS = 2 * 10  # 13 keyframes, 11 of them with neighbours, 1 of these held out


@pytest.mark.parametrize("inside", [5, 11], ids=["in the midst of an epoch", "between epochs"])
def test_killed_inside_the_second_refinement_and_resumed_ends_as_if_it_had_not_been(cli, monkeypatch, inside):
    from tests.loop.fakes import Mortal

    monkeypatch.setattr(Mortal, "trained_in_process", -1000)
    shared = (*MORTAL, *LOOPS, *LEARNING, "training.checkpoint_minutes=0", f"depth.die_at={STEPS + inside}")
    killed_run(*shared, "out=killed")
    assert Path("killed/steps/loops/00/refine.json").is_file()
    assert Path("killed/loops/01/training/checkpoint/last.ckpt").is_file()
    assert not Path("killed/steps/loops/01/refine.json").exists()

    answer = cli("resume=killed")
    assert answer.code == 0, answer.err
    assert f"goes on at step {inside} of {STEPS}" in answer.out
    assert cli(*shared, "out=whole").code == 0
    summaries = [json.loads(Path(f"{run}/summary.json").read_text()) for run in ("killed", "whole")]
    assert without_times(summaries[0]) == without_times(summaries[1])
    assert summaries[0]["loops"][2]["pose"]["wall"]["tracked_frames"] == 26
    for name in ("weights/model.pth", "loops/01/weights/model.pth", "loops/01/training/losses.csv"):
        assert Path("killed", name).read_bytes() == Path("whole", name).read_bytes()
    steps = [line.split(",")[0] for line in Path("killed/loops/01/training/losses.csv").read_text().splitlines()]
    assert steps == ["step", *map(str, range(1, STEPS + 1))]
    assert not Path("killed/loops/01/training/checkpoint").exists()


@pytest.mark.parametrize("step", ["sense", "slam", "depth", "refine", "best_weights"])
def test_stopped_after_any_step_and_resumed(run, cli, monkeypatch, step):
    """Every step but the last finished ones is repeated, and the result stays the same."""
    from prgbd.loop.store import RunStore

    whole = run("task.max_loops=1")
    Path("run").rename("whole")
    finish = RunStore.finish

    def stop_after(self, name, result=None):
        finish(self, name, result)
        if step in name:
            raise KeyboardInterrupt

    monkeypatch.setattr(RunStore, "finish", stop_after)
    stopped = cli(*FAKES, "task.max_loops=1", "out=run")
    assert stopped.code == 130
    monkeypatch.setattr(RunStore, "finish", finish)
    answer = cli("resume=run")
    assert answer.code == 0, answer.err
    assert without_times(json.loads(Path("run/summary.json").read_text())) == without_times(whole)


def test_a_summary_that_was_lost_is_written_anew(run, cli):
    whole = run("task.max_loops=0")
    assert "nothing left to do" in cli("resume=run").out
    Path("run/summary.json").unlink()
    assert cli("resume=run").code == 0
    assert without_times(json.loads(Path("run/summary.json").read_text())) == without_times(whole)


def test_what_may_be_said_beside_resume(run, cli, monkeypatch):
    monkeypatch.setattr("prgbd.loop.store.RunStore.is_finished", False)
    run("task.max_loops=1", "seed=4")
    repeated = cli(*FAKES, "task.max_loops=1", "seed=4", "resume=run", "debug=true")
    assert repeated.code == 0, repeated.err
    defaults = cli("resume=run", "trainer=cpu", "task=self_improve", "training.epochs=auto")
    assert defaults.code == 0, defaults.err
    for contradiction in ("seed=5", "depth=test/nan", "task.max_loops=2", "training.epochs=2", "trainer=auto"):
        answer = cli("resume=run", contradiction)
        assert answer.code == 2
        assert contradiction in answer.sentence


def test_the_newest_unfinished_run_is_found(cli, monkeypatch):
    from tests.loop.fakes import Sideways

    def stopped(self, frame):
        raise KeyboardInterrupt

    assert cli(*FAKES, "task=slam", "out=outputs/a/finished").code == 0
    with monkeypatch.context() as patch:
        patch.setattr(Sideways, "track", stopped)
        for name in ("older", "newer"):
            assert cli(*FAKES, "task=slam", f"out=outputs/a/{name}").code == 130
    os.utime("outputs/a/older/config.yaml", (1, 1))
    assert cli("resume=last").code == 0
    assert Path("outputs/a/newer/summary.json").is_file()
    assert not Path("outputs/a/older/summary.json").exists()
    assert cli("resume=true").code == 0
    assert Path("outputs/a/older/summary.json").is_file()
    assert cli("resume=last").code == 2


def test_other_weights_are_refused(run, cli, monkeypatch, tmp_path):
    import prgbd
    from tests.loop.fakes import Sideways

    def stopped(self, frame):
        raise KeyboardInterrupt

    prgbd.make_depth("test/tiny", start=3.0).save_weights(tmp_path / "weights")
    with monkeypatch.context() as patch:
        patch.setattr(Sideways, "track", stopped)
        assert cli(*FAKES, "depth.weights=weights", "out=run").code == 130
    prgbd.make_depth("test/tiny", start=2.0).save_weights(tmp_path / "weights")
    answer = cli("resume=run")
    assert answer.code == 2
    assert "depth.weights" in answer.sentence


def test_a_run_in_use_is_left_alone(run, cli):
    from prgbd.loop.store import RunStore

    run("task=slam")
    store = RunStore.open(Path("run"))
    answer = cli("resume=run")
    store.close()
    assert answer.code == 2
    assert "Another process" in answer.sentence


def test_two_runs_leave_the_same_files(cli):
    """Weights too: what PyTorch writes may not hold the temporary name that it was written under."""
    for name in ("first", "second"):
        assert cli(*FAKES, "task.max_loops=1", f"out={name}").code == 0
    first, second = (
        {p.relative_to(run): p for p in Path(run).rglob("*.*") if p.is_file()} for run in ("first", "second")
    )
    assert first.keys() == second.keys()
    differ = {str(name) for name in first if first[name].read_bytes() != second[name].read_bytes()}
    assert not [name for name in differ if Path(name).suffix in (".pth", ".tum", ".kitti", ".ply")]


def test_a_resumed_run_keeps_its_number_of_threads(cli, monkeypatch):
    import torch

    from tests.loop.fakes import Sideways

    monkeypatch.setattr(Sideways, "tracked_in_process", -1000)

    killed_run(*FAKES, "task.max_loops=2", "slam.die_at=18", "threads=3", "out=killed")
    assert torch.get_num_threads() != 3
    try:
        assert cli("resume=killed").code == 0
        assert torch.get_num_threads() == 3
        assert json.loads(Path("killed/summary.json").read_text())["threads"] == 3
    finally:
        torch.set_num_threads(1)


@pytest.mark.parametrize("lost", ["training", "trainer"])
def test_a_configuration_that_lost_a_part_is_refused(run, cli, lost):
    run("task.max_loops=0")
    saved = OmegaConf.load("run/config.yaml")
    del saved[lost]
    OmegaConf.save(saved, "run/config.yaml")
    answer = cli("resume=run")
    assert answer.code == 2
    assert f"its part {lost} is not what a run writes" in answer.sentence
