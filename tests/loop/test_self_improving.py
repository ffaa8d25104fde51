"""The loop's own decisions; whole runs are tested through the command line."""

import math

import numpy as np
import pytest

from prgbd.core.errors import ConfigError
from prgbd.core.registry import make_criterion
from prgbd.evaluation.settings import EvaluationSettings
from prgbd.loop.depth_figures import depth_figures, evenly, write_samples
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.loop_settings import LoopSettings, SensingSettings
from prgbd.loop.monitor import SilentMonitor
from prgbd.loop.pose_refinement import PoseRefinement, loop_name
from prgbd.loop.self_improving import stop_reason
from prgbd.loop.sensing import DepthSensor
from tests.loop import fakes
from tests.loop.fakes import Tiny, Wall


@pytest.mark.parametrize(
    ("before", "after", "least", "stops"),
    [
        (1.0, 0.9, 0.0, False),
        (1.0, 1.0, 0.0, True),
        (1.0, 1.1, 0.0, True),
        (1.0, 0.96, 0.05, True),
        (1.0, 0.94, 0.05, False),
        (1.0, math.nan, 0.0, True),
        (1.0, None, 0.0, True),
        (1.0, 1.1, None, False),
        (1.0, None, None, True),
    ],
)
def test_stop_rule(before, after, least, stops):
    reason = stop_reason(make_criterion("held_out"), before, after, least)
    assert bool(reason) == stops
    if stops and None not in (before, after) and after > before:
        assert f"rose from {before:.5f} to {after:.5f}" in reason


def test_names_are_the_paper_s():
    assert [loop_name(k) for k in range(3)] == ["pRGBD-Initial", "pRGBD-Refined", "pRGBD-Refined (2)"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"max_loops": -1},
        {"max_loops": 1.5},
        {"min_improvement": 1.0},
        {"first_teacher": "posenet"},
    ],
)
def test_settings_are_checked(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        LoopSettings(**wrong)


@pytest.mark.parametrize("wrong", [{"baseline_percentile": 0}, {"baseline_percentile": 101}, {"batch_size": 0}])
def test_settings_of_the_sensor_are_checked(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        SensingSettings(**wrong)


def test_evenly_spaced():
    assert evenly(5, None).tolist() == [0, 1, 2, 3, 4]
    assert evenly(100, 3).tolist() == [0, 50, 99]
    assert evenly(2, 9).tolist() == [0, 1]


def test_samples_of_several_sequences_have_one_size(tmp_path):
    small, large = Wall(frames=8), Wall("10", frames=8)
    sensors = [DepthSensor(Tiny(), sequence, tmp_path, name="t") for sequence in (small, large)]
    write_samples(sensors, tmp_path / "samples.npz", count=6)
    samples = np.load(tmp_path / "samples.npz")
    assert samples["images"].shape == (6, 64, 96, 3)
    assert samples["depth"].shape == samples["truth"].shape == (6, 64, 96)
    assert samples["sequence"].tolist() == ["wall"] * 3 + ["10"] * 3
    for row, index in enumerate(samples["frame_index"]):
        sensor = sensors[row // 3]
        np.testing.assert_allclose(samples["depth"][row], sensor.depth(int(index)))
        np.testing.assert_array_equal(samples["images"][row], sensor.sequence.frame(int(index)).image)


def test_depth_figures_count_images_with_truth(tmp_path):
    class Blind(Wall):
        def depth(self, index):
            return super().depth(index) if index % 2 else None

    class NoTruth(Wall):
        def depth(self, index):
            return None

    figures = depth_figures(
        [DepthSensor(Tiny(), Blind(frames=6), tmp_path, name="t")], EvaluationSettings(depth_images=None)
    )
    assert (figures["images"], figures["images_without_truth"]) == (3, 3)
    assert depth_figures([DepthSensor(Tiny(), NoTruth(frames=6), tmp_path, name="t")]) is None


@pytest.mark.parametrize(
    ("sigma", "options", "warned"),
    [
        (0.46, {"first_teacher": "pseudo_rgbd"}, True),
        (0.19, {"first_teacher": "pseudo_rgbd"}, False),
        (None, {"first_teacher": "pseudo_rgbd"}, False),
        (0.46, {"first_teacher": "mono"}, False),
        (0.46, {}, False),
        (0.46, {"first_teacher": "pseudo_rgbd", "max_loops": 0}, False),
    ],
)
def test_a_network_that_does_not_know_the_scene_is_pointed_out(sigma, options, warned):
    heard = Listener()
    settings = LoopSettings(**options)
    parts = LoopParts(
        estimator=Tiny(),
        make_slam=fakes.Sideways,
        sequences=[Wall()],
        settings=settings,
        store=None,
        identity=None,
        monitor=heard,
    )
    PoseRefinement(parts, 0)._warn_of_a_strange_scene("wall", {"depth_sigma": sigma})
    assert bool(heard.said) == warned
    if warned:
        assert "wall is wrong by 46%" in heard.said[0]
        assert "task.first_teacher=mono" in heard.said[0]


class Listener(SilentMonitor):
    def __init__(self):
        self.said = []

    def say(self, line):
        self.said.append(line)
