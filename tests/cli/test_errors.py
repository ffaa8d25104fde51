"""Bad input: one clear sentence that names the file or option, exit code 2, and no half-made run."""

import signal
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.conftest import FAKES


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["slam=ID", "orb_gtsam", "depth=ID", "monodepth2"]),
        (["task=slam"], ["slam=ID", "orb_gtsam"]),
        (["task=depth"], ["depth=ID", "monodepth2"]),
        (["task=evaluate"], ["depth=ID", "task.trajectory"]),
        (["slam=orb_gtsm", "depth=monodepth2"], ["'orb_gtsm'", "'orb_gtsam'"]),
        (["+slam=orb_gtsam", "+depth=monodepth"], ["'monodepth'", "'monodepth2'"]),
        (["data=kitti_odomtry"], ["'kitti_odomtry'", "'kitti_odometry'"]),
        (["loss=no_foto"], ["loss", "'no_foto'", "no_photometric"]),
        (["experiment=adapt"], ["'adapt'", "slam=orb_gtsam depth=monodepth2"]),
        (["experiment=kitti_eigen"], ["'kitti_eigen'", "experiment=paper/kitti_eigen"]),
        ([*FAKES, "task.budget=soon"], ["task.budget is 'soon'", "10min", "500"]),
        ([*FAKES, "task.budget=0"], ["task.budget is '0'"]),
        ([*FAKES, "task.budget=1h", "training.epochs=2"], ["task.budget=1h", "training.epochs=2"]),
        (["tsk=slam"], ["'tsk'", "'task'"]),
        (["training.lerning_rate=1"], ["training.lerning_rate", "training.learning_rate"]),
        (["nonsense"], ["'nonsense'", "--help"]),
        (["--nonsense"], ["--nonsense"]),
        (["seed="], ["seed"]),
        (["seed=x", *FAKES], ["seed", "'x'"]),
        (["data.scene=a(b"], ["data.scene=a(b", "quotes"]),
        (["depth.weights=x", "slam=orb_gtsam"], ["depth.weights", "depth=ID"]),
        (["data=kitti_odometry", *FAKES[:2]], ["data.root"]),
        ([*FAKES, "slam.evry=3"], ["'slam.evry'", "'slam.every'", "test/sideways"]),
        (
            ["slam=orb_gtsam", *FAKES[1:], "slam.keyframe_ratio=0.8"],
            ["slam.keyframe_ratio", "slam.keyframes.ratio=0.8"],
        ),
        (["slam=orb_gtsam", *FAKES[1:], "slam.tracking.restart=3"], ["'slam.tracking.restart_after'"]),
        (["slam=orb_gtsam", *FAKES[1:], "slam.features.count=many"], ["slam.features.count", "'many'", "auto"]),
        (["slam=orb_gtsam", *FAKES[1:], "slam.solver=ceres"], ["slam.optimisation.solver", "numba or gtsam"]),
        ([*FAKES, "slam.mode=stereoo"], ["slam.mode is 'stereoo'", "rgbd"]),
        ([*FAKES, "slam.mode=mono"], ["slam.mode=mono", "task=slam"]),
        ([*FAKES, "slam.baseline=-1"], ["slam.baseline is -1", "positive number"]),
        ([*FAKES, "task.max_loops=-1"], ["task.max_loops"]),
        ([*FAKES, "training.epochs=0"], ["training.epochs"]),
        ([*FAKES, "training.learning_rate=fast"], ["training.learning_rate", "'fast'"]),
        ([*FAKES, "training.augment=perhaps"], ["training.augment", "'perhaps'"]),
        ([*FAKES, "training.batch_size=1.5"], ["training.batch_size", "1.5"]),
        ([*FAKES, "+training.lr=1"], ["'training.lr'", "'training.learning_rate'"]),
        ([*FAKES, "task=evaluate", "task.alignment=se3"], ["'task.alignment'", "'evaluation.alignment'"]),
        ([*FAKES, "training.lr=1"], ["'training.lr'", "'training.learning_rate'"]),
        ([*FAKES, "training.batchsize=1"], ["'training.batch_size'"]),
        ([*FAKES, "max_loops=1"], ["'max_loops'", "'task.max_loops'"]),
        ([*FAKES, "loss.photometric=-1"], ["loss.photometric.weight is -1"]),
        ([*FAKES, "loss.photometric=much"], ["loss.photometric.weight", "'much'", "number"]),
        ([*FAKES, "loss.photometrc.weight=1"], ["loss plug-in 'photometrc'", "'photometric'"]),
        ([*FAKES, "loss.depth_transfer.patc=1"], ["'loss.depth_transfer.patc'", "'loss.depth_transfer.patch'"]),
        ([*FAKES, "loss.depth_transfer.patch=4"], ["loss.depth_transfer.patch is 4", "odd"]),
        ([*FAKES, "loss.depth_consistency.residual=lg"], ["loss.depth_consistency.residual", "absolute or log"]),
        ([*FAKES, "training.residual=log"], ["'training.residual'", "loss.depth_transfer.residual"]),
        ([*FAKES, "task.criterion=hold_out"], ["criterion plug-in 'hold_out'", "'held_out'"]),
        ([*FAKES, "criterion.share=1"], ["'criterion.share'"]),
        ([*FAKES, "augmentation.jiter.strength=1"], ["augmentation plug-in 'jiter'", "'jitter'"]),
        ([*FAKES, "augmentation.jitter.strength=-1"], ["augmentation.jitter.strength is -1"]),
        ([*FAKES, "augmentation.mirror=2"], ["augmentation.mirror.probability is 2.0", "from 0 to 1"]),
        ([*FAKES, "evaluation.alignment=sim2"], ["evaluation.alignment", "sim3"]),
        ([*FAKES, "data.root=/no/such/folder"], ["/no/such/folder", "data.root"]),
        ([*FAKES, "+data.sequences=[07]"], ["'07'", "'00'"]),
        ([*FAKES[:1], "depth=test/fussy", "depth.weights=w.pth", FAKES[2]], ["w.pth", "weights"]),
        (["task=slam", "slam.mode=rgbd", *FAKES], ["wall", "slam.mode=mono"]),
        ([*FAKES, "evaluation.depth_test=all"], ["evaluation.depth_test is 'all'", "group of options"]),
        ([*FAKES, "evaluation.depth_test={frmes: 3}"], ["'data.frmes'", "'data.frames'"]),
        (["resume=nowhere"], ["nowhere", "config.yaml"]),
        (["resume=last"], ["unfinished", "outputs"]),
        (["-m", "resume=last"], ["multirun"]),
        (["executor=submitit", *FAKES], ["hydra-submitit-launcher"]),
        (["trainer=gpu", *FAKES], ["trainer=gpu"]),
        (["trainer.devices=x", *FAKES], ["trainer", "devices"]),
        (["+trainer.max_steps_=1", *FAKES], ["trainer", "max_steps_"]),
        (["out=", *FAKES], ["out= is empty"]),
        (["resume=''"], ["resume= is empty"]),
        (["out=/proc/run", *FAKES], ["/proc/run", "out="]),
        (["sensing.cache=/proc/cache", *FAKES], ["sensing.cache=/proc/cache"]),
        (["sensing.precision=half", *FAKES], ["sensing.precision", "bfloat16"]),
        (["sensing.compile=perhaps", *FAKES], ["sensing.compile", "true or false"]),
        (["loss=all,no_smoothness", *FAKES], ["loss=all,no_smoothness", "-m"]),
        (["slam=null", "depth=test/tiny"], ["slam=ID"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_arguments(cli, arguments, words):
    answer = cli(*arguments, *([] if any(a.startswith(("resume", "out")) for a in arguments) else ["out=run"]))
    assert answer.code == 2
    for word in words:
        assert word in answer.sentence
    assert not Path("run/summary.json").exists()
    assert not Path("run").exists()


@pytest.mark.parametrize(("network", "value"), [("nan", "NaN"), ("zero", "zero")])
def test_spoilt_depth_names_plugin_and_frame_and_keeps_what_was_done(cli, network, value):
    answer = cli(FAKES[0], f"depth=test/{network}", FAKES[2], "out=run")
    assert answer.code == 2
    for word in (f"test/{network}", "frame 2", "wall", value):
        assert word in answer.sentence
    assert "resume=run" in answer.err
    assert Path("run/steps/truth.json").is_file()
    assert not Path("run/steps/loops").exists()
    assert not list(Path("run/cache").glob("*"))


def test_depth_of_the_wrong_shape_names_the_plugin_and_the_right_shape(cli):
    answer = cli(FAKES[0], "depth=test/flat", FAKES[2], "out=run")
    assert answer.code == 2
    for word in ("'test/flat'", "must be (1, 1, H, W)"):
        assert word in answer.sentence


def test_debug_shows_the_traceback(cli):
    answer = cli(*FAKES, "slam.baseline=-1", "debug=true")
    assert answer.code == 2
    assert "Traceback" in answer.err


def images(folder: Path, count: int = 4) -> Path:
    folder.mkdir()
    for index in range(count):
        picture = np.random.default_rng(index).integers(0, 255, (64, 96, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{index:03d}.png"), picture)
    return folder


def test_a_file_for_a_folder_and_a_folder_for_a_file(cli, tmp_path):
    (tmp_path / "drive.MP4").write_bytes(b"")
    assert "data=video" in cli(*FAKES[:2], "data=images", "data.root=drive.MP4", "data.fov=70", "out=run").sentence
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "0.png").write_bytes(b"")
    assert "data=images" in cli(*FAKES[:2], "data=video", "data.root=frames", "data.fov=70", "out=run").sentence


def test_nothing_is_said_to_be_kept_where_nothing_was_done(cli, monkeypatch):
    from prgbd.core.errors import DataError
    from prgbd.loop.self_improving import SelfImprovingLoop

    def fail(_):
        raise DataError("The truth is out there; fetch it.")

    monkeypatch.setattr(SelfImprovingLoop, "run", fail)
    answer = cli(*FAKES, "out=run")
    assert "fetch it" in answer.sentence
    assert "resume" not in answer.err


def test_empty_folder(cli, tmp_path):
    (tmp_path / "empty").mkdir()
    answer = cli(*FAKES[:2], "data=images", "data.root=empty", "data.fov=60", "out=run")
    assert answer.code == 2
    assert "empty" in answer.sentence
    assert not Path("run").exists()


def test_truncated_image_keeps_what_was_done(cli, tmp_path):
    broken = sorted(images(tmp_path / "pictures").iterdir())[2]
    broken.write_bytes(broken.read_bytes()[:60])
    answer = cli(*FAKES[:2], "data=images", "data.root=pictures", "data.fov=60", "out=run")
    assert answer.code == 2
    assert "002.png" in answer.sentence


@pytest.mark.parametrize("content", ["fx: [1", "fx: 0\nfy: 0\ncx: 1\ncy: 1\n", "no camera here"])
def test_wrong_calibration_file(cli, tmp_path, content):
    images(tmp_path / "pictures")
    (tmp_path / "camera.yaml").write_text(content)
    answer = cli(*FAKES[:2], "data=images", "data.root=pictures", "data.camera=camera.yaml", "out=run")
    assert answer.code == 2
    assert "camera" in answer.sentence
    assert not Path("run").exists()


def test_weights_of_the_wrong_network(cli, tmp_path):
    import prgbd

    prgbd.make_depth("rt_monodepth").save_weights(tmp_path / "weights")
    answer = cli(FAKES[0], "depth=monodepth2", "depth.weights=weights", FAKES[2], "out=run")
    assert answer.code == 2
    assert "weights" in answer.sentence
    assert not Path("run").exists()


def test_a_bug_keeps_its_traceback(cli, monkeypatch):
    monkeypatch.setattr("prgbd.loop.pose_refinement.run_slam", None)
    with pytest.raises(TypeError):
        cli(*FAKES, "out=run")
    assert "TypeError" in Path("run/run.log").read_text()


@pytest.mark.parametrize(
    "place", ["tests.loop.fakes.Sideways.track", "prgbd.training.refinement_module.DepthRefinement.training_step"]
)
def test_ctrl_c_says_how_to_go_on(cli, monkeypatch, place):
    def stopped(*args, **kwargs):
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(place, stopped)
    answer = cli(*FAKES, "out=run")
    assert signal.getsignal(signal.SIGINT) is before
    assert answer.code == 130
    assert "resume=run" in answer.sentence
