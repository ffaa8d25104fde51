"""A network learns from SLAM's points which of its pixels err."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from prgbd import DepthEstimator, DepthPrediction
from prgbd.core.errors import ConfigError
from prgbd.core.sigma_head import SigmaHead
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.loop_settings import LoopSettings
from prgbd.loop.self_improving import SelfImprovingLoop
from prgbd.loop.sensing import DepthSensor
from prgbd.loop.sigma_learning import describe_sigma, keyframes_apart, learn_sigma
from prgbd.loop.sigma_points import sigma_points
from prgbd.loop.uncertainty_figures import describe_uncertainty, uncertainty_figures
from prgbd.training.refinement_settings import RefinementSettings
from tests.loop.fakes import Sideways
from tests.training.scenes import WallSequence, true_slam_result

ERRORS = (0.05, 0.3)
"""Standard deviation of log depth in the left and in the right half of the image."""


class HalfBlind(DepthEstimator):
    """Knows the wall's depth but for noise, which is larger in the right half; its features are the halves."""

    input_size, depth_range = (64, 96), (0.1, 100.0)

    def __init__(self, headed: bool = True) -> None:
        super().__init__()
        true = torch.from_numpy(WallSequence(1).depth(0)).log()
        side = (torch.arange(96) >= 48).float().expand(64, 96)
        noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(64, 96)), (0, 0), 1.5)  # as wide as a keypoint
        noise = torch.from_numpy(noise / noise.std()).float()
        self.log_depth = torch.nn.Parameter(true + (ERRORS[0] + (ERRORS[1] - ERRORS[0]) * side) * noise + 0.7)
        self.side = side
        self.head = SigmaHead([1]) if headed else None

    def forward(self, images):
        depth = self.log_depth.exp().expand(len(images), 1, 64, 96)
        return DepthPrediction((depth,), sigma=None if self.head is None else self.head(self.sigma_features(images)))

    def sigma_head(self):
        return self.head

    def sigma_features(self, images):
        return [self.side.expand(len(images), 1, 64, 96)]


@pytest.fixture(scope="module")
def supervised():
    sequence = WallSequence(24, step=0.12)
    return [(sequence, true_slam_result(sequence, points=250))]


def test_both_halves_are_told_apart_and_depth_stays(supervised):
    network = HalfBlind()
    image = supervised[0][0].frame(0).image
    before = network.predict(image)
    apart = keyframes_apart(supervised, 0.25)
    found = learn_sigma(network, supervised, apart)
    depth, sigma = network.predict_with_sigma(image)
    np.testing.assert_array_equal(depth, before)
    assert float(sigma[30, 10]) == pytest.approx(ERRORS[0], rel=0.35)
    assert float(sigma[30, 80]) == pytest.approx(ERRORS[1], rel=0.35)
    assert found["sigma_within_one"] == pytest.approx(0.68, abs=0.06)
    assert found["sigma_within_two"] == pytest.approx(0.95, abs=0.06)
    assert found["sigma_held_out_points"] > 100
    assert "68 %" in describe_sigma(found)
    again = HalfBlind()
    assert learn_sigma(again, supervised, apart) == found
    assert torch.equal(again.head.weight, network.head.weight)


def test_the_points_of_some_keyframes_and_no_more_than_asked_for(supervised):
    (sequence, result), network = supervised[0], HalfBlind()
    points = sigma_points(network, sequence, result, features=True)
    few = sigma_points(network, sequence, result, features=False, most=160)
    assert len(few) < 2 * 160 < len(points)
    assert few.features is None
    frame = int(result.keyframes.frame_index[2])
    chosen = points.of([frame])
    assert set(chosen.frame.tolist()) == {frame}
    assert len(chosen) == len(chosen.errors) == len(chosen.sigma) == len(chosen.features)


def test_nothing_is_learnt_without_a_head_or_without_points(supervised):
    sequence, result = supervised[0]
    assert learn_sigma(HalfBlind(headed=False), supervised, []) is None
    seen = result.observations
    few = type(seen)(seen.keyframe[:60], seen.point[:60], seen.uv[:60], seen.depth[:60])
    network = HalfBlind()
    assert learn_sigma(network, [(sequence, replace(result, observations=few))], []) is None
    assert float(network.head.weight.abs().sum()) == 0


def test_figures_against_truth_and_points_agree(supervised, tmp_path):
    sequence, result = supervised[0]
    network = HalfBlind()
    learn_sigma(network, supervised, [])
    sensor = DepthSensor(network, sequence, tmp_path, name="half-blind")
    found = uncertainty_figures([sensor], results=[(sensor, result)])
    for name in ("truth", "points"):
        assert found[name]["within_one"] == pytest.approx(0.68, abs=0.09)
        assert found[name]["ause"] < 0.7
    assert "within one deviation" in describe_uncertainty(found)
    silent = DepthSensor(HalfBlind(headed=False), sequence, tmp_path, name="silent")
    assert uncertainty_figures([silent], results=[(silent, result)]) is None


def test_uncertainty_alone_is_refused_to_a_network_that_has_none():
    parts = LoopParts(
        estimator=HalfBlind(headed=False),
        make_slam=Sideways,
        sequences=[WallSequence(12)],
        settings=LoopSettings(max_loops=1),
        store=None,
        identity=SimpleNamespace(depth="half-blind"),
        refinement=RefinementSettings(learn="uncertainty"),
    )
    with pytest.raises(ConfigError, match=r"depth=half-blind.*training\.learn=uncertainty.*depth\.uncertainty=true"):
        SelfImprovingLoop(parts).run()
