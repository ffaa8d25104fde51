"""A plug-in that raises at import, returns NaN or returns the wrong shape is named in one sentence; the rest works."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import prgbd
from prgbd import DepthPrediction, TrackingResult, TrackingState
from prgbd.core.errors import PrgbdError
from prgbd.core.registry import KINDS, REGISTRY
from prgbd.plugins.__main__ import main as plugins
from tests.loop.fakes import Sideways, Tiny, Wall

HERE = __name__
SOUND = {"slam": "test/sideways", "depth": "test/tiny", "data": "test/wall"}

# A package as pip installs it: its plug-ins fail before there is a class.
METADATA = "Metadata-Version: 2.1\nName: bad-lab\nVersion: 0.3\nSummary: Nothing here works\n"
ENTRY_POINTS = "".join(
    f"[prgbd.{kind}]\nbad/raises = bad_lab_raises:Net\nbad/exits = bad_lab_exits:Net\nbad/absent = bad_lab_absent:Net\n"
    "bad/nameless = bad_lab_fine:Nothing\nbad/stranger = bad_lab_fine:Stranger\n"
    for kind in KINDS
)
MODULES = {
    "bad_lab_raises": "raise RuntimeError('no licence found')",
    "bad_lab_exits": "import sys; sys.exit('good bye')",
    "bad_lab_fine": "class Stranger: pass",
}


class RaisesWhenMade:
    def __init__(self, *args, **kwargs):
        raise RuntimeError("out of paper")


class DepthMade(RaisesWhenMade, Tiny):
    pass


class SlamMade(RaisesWhenMade, Sideways):
    pass


class DataMade(RaisesWhenMade, Wall):
    pass


class DepthAbstract(prgbd.DepthEstimator):
    def __init__(self, weights=None):
        super().__init__()


class SlamAbstract(prgbd.GeometricSLAM):
    modes = frozenset({"rgbd"})


class DataAbstract(prgbd.Sequence):
    def __init__(self, sequence=None):
        pass


class DepthNan(Tiny):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth * torch.nan,))


class DepthZero(Tiny):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth * 0,))


class DepthNegative(Tiny):
    def forward(self, images):
        return DepthPrediction((-super().forward(images).depth,))


class DepthFlat(Tiny):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth[:, 0],))


class DepthBare(Tiny):
    def forward(self, images):
        return super().forward(images).depth


class DepthArray(Tiny):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth.detach().numpy(),))


class DepthInteger(Tiny):
    def forward(self, images):
        return DepthPrediction((super().forward(images).depth.int() + 1,))


class DepthSmallPrediction(Tiny):
    def predict(self, image):
        return super().predict(image)[::2]


class DepthDouble(Tiny):
    def predict(self, image):
        return super().predict(image).astype(np.float64)


class SlamNan(Sideways):
    def track(self, frame):
        return replace(super().track(frame), wTc=np.full((4, 4), np.nan))


class SlamStretched(Sideways):
    def track(self, frame):
        return replace(super().track(frame), wTc=np.diag([2.0, 1, 1, 1]))


class SlamMirrored(Sideways):
    def track(self, frame):
        return replace(super().track(frame), wTc=np.diag([-1.0, 1, 1, 1]))


class SlamSmall(Sideways):
    def track(self, frame):
        return replace(super().track(frame), wTc=np.eye(3))


class SlamTuple(Sideways):
    def track(self, frame):
        return TrackingState.OK, super().track(frame).wTc


class SlamPoseless(Sideways):
    def track(self, frame):
        super().track(frame)
        return TrackingResult(TrackingState.OK)


class SlamForgets(Sideways):
    def finish(self):
        return replace(super().finish(), frames=3)


class SlamBends(Sideways):
    def finish(self):
        result = super().finish()
        wTc = result.trajectory.wTc.copy()
        wTc[5, :3, :3] *= 1.5
        return replace(result, trajectory=replace(result.trajectory, wTc=wTc))


class SlamNothing(Sideways):
    def finish(self):
        return None


class DataSmall(Wall):
    def frame(self, index):
        frame = super().frame(index)
        return replace(frame, image=frame.image[:40]) if index == 3 else frame


class DataGray(Wall):
    def frame(self, index):
        frame = super().frame(index)
        return replace(frame, image=frame.image[..., 0])


class DataFloat(Wall):
    def frame(self, index):
        frame = super().frame(index)
        return replace(frame, image=frame.image / 255.0)


class DataNanDepth(Wall):
    def depth(self, index):
        return super().depth(index) * np.float32("nan")


class DataBackwards(Wall):
    def __init__(self, sequence=None):
        super().__init__(sequence)
        self.timestamps = self.timestamps[::-1].copy()


class DataPoses(Wall):
    @property
    def poses(self):
        return super().poses[:-1]


BAD = [
    *((kind, "bad/raises", ["bad-lab 0.3", "no licence found"]) for kind in KINDS),
    *((kind, "bad/exits", ["bad-lab 0.3", "good bye"]) for kind in KINDS),
    ("depth", "bad/absent", ["bad_lab_absent"]),
    ("slam", "bad/nameless", ["Nothing"]),
    *((kind, "bad/stranger", ["no subclass of prgbd."]) for kind in KINDS),
    ("depth", "DepthMade", ["out of paper"]),
    ("slam", "SlamMade", ["out of paper"]),
    ("data", "DataMade", ["out of paper"]),
    ("depth", "DepthAbstract", ["forward"]),
    ("slam", "SlamAbstract", ["track"]),
    ("data", "DataAbstract", ["frame"]),
    ("depth", "DepthNan", ["NaN"]),
    ("depth", "DepthZero", ["zero"]),
    ("depth", "DepthNegative", ["negative"]),
    ("depth", "DepthFlat", ["(1, 1, H, W)"]),
    ("depth", "DepthBare", ["Tensor", "prgbd.DepthPrediction"]),
    ("depth", "DepthArray", ["float32", "torch tensor"]),
    ("depth", "DepthInteger", ["torch.int32", "floating point"]),
    ("depth", "DepthSmallPrediction", ["(32, 96)", "(64, 96)"]),
    ("depth", "DepthDouble", ["float64", "float32"]),
    ("slam", "SlamNan", ["pose that is not finite"]),
    ("slam", "SlamStretched", ["no rigid transform"]),
    ("slam", "SlamMirrored", ["no rigid transform"]),
    ("slam", "SlamSmall", ["(3, 3)", "(4, 4)"]),
    ("slam", "SlamTuple", ["tuple", "prgbd.TrackingResult"]),
    ("slam", "SlamPoseless", ["no pose"]),
    ("slam", "SlamForgets", ["3 frames", "12"]),
    ("slam", "SlamBends", ["frame 5", "no rigid transform"]),
    ("slam", "SlamNothing", ["NoneType", "SlamResult"]),
    ("data", "DataSmall", ["frame 3", "(40, 96, 3)", "(64, 96, 3)"]),
    ("data", "DataGray", ["(64, 96)", "(64, 96, 3)"]),
    ("data", "DataFloat", ["float64", "uint8"]),
    ("data", "DataNanDepth", ["NaN"]),
    ("data", "DataBackwards", ["ascend"]),
    ("data", "DataPoses", ["(11, 4, 4)", "12 frames"]),
]
ids = [f"{kind}-{plugin_id.removeprefix('bad/')}" for kind, plugin_id, _ in BAD]


@pytest.fixture(autouse=True)
def bad_lab(monkeypatch, tmp_path_factory):
    """An installed package of broken plug-ins, and broken classes registered in code; all gone after the test."""
    site = tmp_path_factory.mktemp("site")
    info = site / "bad_lab-0.3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(METADATA)
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    for name, text in MODULES.items():
        (site / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(REGISTRY, "_specs", dict(REGISTRY._specs))
    for kind, plugin_id, _ in BAD:
        if not plugin_id.startswith("bad/"):
            REGISTRY.register(prgbd.PluginSpec(kind, f"bad/{plugin_id}", f"{HERE}:{plugin_id}"))
    yield
    for name in MODULES:
        sys.modules.pop(name, None)


def full(plugin_id: str) -> str:
    return plugin_id if plugin_id.startswith("bad/") else f"bad/{plugin_id}"


@pytest.mark.parametrize(("kind", "plugin_id", "words"), BAD, ids=ids)
def test_the_command_line_names_it_in_one_sentence(cli, kind, plugin_id, words) -> None:
    chosen = SOUND | {named(kind): full(plugin_id)}
    answer = cli(*(f"{name}={value}" for name, value in chosen.items()), "task.max_loops=0", "out=run")
    assert answer.code == 2
    for word in (f"'{full(plugin_id)}'", *words):
        assert word in answer.sentence
    assert not Path("run/summary.json").exists()


def named(kind: str) -> str:
    """The option that names a plug-in of a kind."""
    return {"loss": "loss.x.id", "criterion": "task.criterion", "augmentation": "augmentation.x.id"}.get(kind, kind)


def walk(kind: str, plugin_id: str) -> None:
    """Use a plug-in from Python as people do."""
    wall = prgbd.make_data("test/wall")
    made = REGISTRY.make(kind, plugin_id)
    if kind == "depth":
        depth = made.predict(wall.frame(0).image)
        slam = prgbd.make_slam("test/sideways")
        slam.reset(wall.camera, "rgbd", baseline=0.1)
        slam.track(wall.frame(0).with_depth(depth))
    elif kind == "slam":
        made.reset(wall.camera, "mono")
        for index in range(len(wall)):
            made.track(wall.frame(index))
        made.finish()
    else:
        for index in range(len(made)):
            made.frame(index), made.depth(index)
        assert made.poses is not None


@pytest.mark.parametrize(("kind", "plugin_id", "words"), BAD, ids=ids)
def test_python_raises_one_sentence(cli, kind, plugin_id, words) -> None:
    with pytest.raises(PrgbdError) as caught:
        walk(kind, full(plugin_id))
    message = str(caught.value)
    assert "\n" not in message
    # What only predict spoils is caught where it is used, which does not know whose depth it is.
    if plugin_id not in ("DepthSmallPrediction", "DepthDouble"):
        assert f"'{full(plugin_id)}'" in message
    for word in words:
        assert word in message


def test_the_listing_and_the_sound_ones_still_work(cli, capfd) -> None:
    assert plugins([]) == 0
    listing = capfd.readouterr()
    assert listing.err == ""
    for plugin_id in ("orb_gtsam", "monodepth2", "synthetic", "bad/raises", "bad/exits", "bad/stranger"):
        assert any(line.startswith(plugin_id) for line in listing.out.splitlines())
    answer = cli(*(f"{kind}={plugin_id}" for kind, plugin_id in SOUND.items()), "task.max_loops=0", "out=run")
    assert answer.code == 0, answer.err


def test_a_traceback_of_a_plugin_ends_with_its_name(cli) -> None:
    class Stumbles(Sideways):
        def track(self, frame):
            return 1 / 0

    sys.modules[HERE].Stumbles = Stumbles
    prgbd.register_slam("bad/stumbles", f"{HERE}:Stumbles")
    with pytest.raises(ZeroDivisionError) as caught:
        walk("slam", "bad/stumbles")
    assert caught.value.__notes__ == [
        "The slam plug-in 'bad/stumbles' raised this; mend it, or choose another plug-in."
    ]
