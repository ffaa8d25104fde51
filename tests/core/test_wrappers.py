"""Wrappers of depth estimators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import prgbd
from prgbd import DepthPrediction
from prgbd.core.errors import ConfigError, WeightsError
from prgbd.core.self_doubting import SelfDoubting
from prgbd.core.wrappers import (
    WRAPPERS,
    AffineCorrupted,
    Cached,
    Clipped,
    DepthWrapper,
    FlipAveraged,
    MedianScaled,
    Scaled,
    description,
    wrap,
)
from tests.core.plugins import Constant


class LeftRight(Constant):
    """Says that what is at the left of the picture is near, whatever the picture shows."""

    calls = 0

    def forward(self, images):
        self.calls += 1
        across = torch.linspace(1.0, 4.0, images.shape[3]).expand(len(images), 1, *images.shape[2:])
        return DepthPrediction((across * self.log_depth.exp() * (1 + images.mean(1, keepdim=True)),))


class Unsure(LeftRight):
    """Says as well that it errs the more the nearer."""

    def forward(self, images):
        prediction = super().forward(images)
        return replace(prediction, sigma=0.1 / prediction.depth.detach())


@pytest.fixture
def images():
    return torch.rand((2, 3, 32, 64), generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    "wrappers",
    [
        ["flip_averaged"],
        [{"scaled": {"factor": 5.4}}],
        [{"median_scaled": {"median": 3.0}}],
        [{"clipped": {"farthest": 7.0}}],
        ["cached"],
        [{"affine_corrupted": {"seed": 1}}],
        ["self_doubting"],
        [{"self_doubting": {"mirror": False}}, "flip_averaged"],
        [{"clipped": {"nearest": 3.0, "farthest": 9.0}}, "flip_averaged", {"cached": {"size": 2}}],
    ],
    ids=str,
)
def test_every_wrapper_keeps_the_contract(wrappers) -> None:
    wrapped = wrap(LeftRight(), wrappers)
    prgbd.check_depth_estimator(wrapped)
    assert isinstance(wrapped, DepthWrapper)
    assert isinstance(wrapped.unwrapped, LeftRight)


@pytest.mark.parametrize(
    "name", ["flip_averaged", {"scaled": {"factor": 2}}, "median_scaled", "clipped", "cached"], ids=str
)
def test_every_wrapper_hands_deviations_on(name, images) -> None:
    wrapped = wrap(Unsure(), [name])
    prgbd.check_depth_estimator(wrapped)
    image = (255 * images[0].permute(1, 2, 0)).byte().numpy()
    depth, sigma = wrapped.predict_with_sigma(image)
    assert sigma.shape == depth.shape == image.shape[:2]
    # Scale is no matter of the deviations, and the mirror image says of the middle what the image says of it.
    middle = np.s_[:, 31:33]
    np.testing.assert_allclose(sigma[middle], Unsure().predict_with_sigma(image)[1][middle], rtol=0.05)


def test_flip_averaging_takes_a_bias_of_the_sides_out_of_the_middle(images) -> None:
    wrapped = FlipAveraged(LeftRight()).eval()
    flat = torch.full_like(images, 0.5)
    inverse = 1 / wrapped(flat).depth[0, 0, 0]
    middle = inverse[8:-8]
    assert torch.allclose(middle, middle.flip(0), rtol=1e-4)
    alone = 1 / wrapped.unwrapped(flat).depth[0, 0, 0]
    assert torch.allclose(inverse[:3], alone.flip(0)[:3], rtol=1e-4)  # at the borders the side with context counts
    assert torch.allclose(inverse[-3:], alone[-3:], rtol=1e-4)
    mirrored = wrapped(images.flip(3)).depth.flip(3)
    assert torch.allclose(wrapped(images).depth, mirrored, rtol=1e-4)


def test_flip_averaging_leaves_training_alone(images) -> None:
    wrapped = FlipAveraged(LeftRight()).train()
    assert torch.equal(wrapped(images).depth, wrapped.unwrapped(images).depth)


def test_scales_and_limits(images) -> None:
    inner = LeftRight()
    expected = inner(images).depth
    scaled = Scaled(inner, 2.5)
    assert torch.allclose(scaled(images).depth, 2.5 * expected)
    assert (scaled.metric, scaled.depth_range) == (True, (0.25, 250.0))
    even = MedianScaled(inner, 3.0)(images).depth
    assert torch.allclose(even.flatten(1).median(1).values, torch.tensor(3.0))
    assert torch.allclose(even / expected, (even / expected)[:, :, :1, :1].expand_as(even))
    clipped = Clipped(inner, farthest=6.0)
    assert clipped.depth_range == (0.1, 6.0)
    assert torch.equal(clipped(images).depth, expected.clamp(max=6.0))


def test_the_cache_predicts_once_until_image_or_weights_change() -> None:
    inner = LeftRight()
    cached = Cached(inner, size=2)
    first, second, third = (np.full((40, 70, 3), level, np.uint8) for level in (0, 100, 200))
    depth = cached.predict(first)
    depth[:] = -1.0  # what is handed out is the caller's own
    assert cached.predict(first).min() > 0
    assert inner.calls == 1
    cached.predict(second)
    cached.predict(third)
    assert inner.calls == 3
    cached.predict(first)  # had to make room
    assert inner.calls == 4
    with torch.no_grad():
        inner.log_depth.add_(0.5)
    assert cached.predict(first).mean() == pytest.approx(np.exp(0.5) * LeftRight().predict(first).mean(), rel=1e-4)
    assert inner.calls == 5


def test_weights_stored_through_a_wrapper_are_read_without_it(tmp_path, images) -> None:
    inner = LeftRight(value=7.0)
    wrap(inner, ["flip_averaged"]).save_weights(tmp_path)
    fresh = LeftRight()
    fresh.load_weights(tmp_path)
    assert torch.equal(fresh(images).depth, inner(images).depth)


def test_wrappers_with_other_options_are_told_apart() -> None:
    near, far = ([{"clipped": {"farthest": limit}}, "flip_averaged"] for limit in (5.0, 6.0))
    assert description(Constant()) == []
    assert description(wrap(Constant(), near)) != description(wrap(Constant(), far))
    assert len(description(wrap(Constant(), near))) == 2


@pytest.mark.parametrize(
    ("wrappers", "match"),
    [
        (["flipped"], "no depth wrapper 'flipped'; choose from flip_averaged"),
        ([{"scaled": {}}], r"depth\.wrappers\.scaled\.factor has no default"),
        ([{"scaled": {"factor": -1}}], "positive number"),
        ([{"clipped": {"far": 3}}], r"no option 'depth\.wrappers\.clipped\.far'"),
        ([{"clipped": {"nearest": 5, "farthest": 2}}], "nothing between"),
        ([{"clipped": 3}], r"\{option: value\}"),
        ([3], "neither a name"),
    ],
)
def test_what_cannot_work_is_refused_in_one_sentence(wrappers, match) -> None:
    with pytest.raises(ConfigError, match=match):
        wrap(Constant(), wrappers)


def test_all_are_there() -> None:
    shipped = {"affine_corrupted", "flip_averaged", "scaled", "median_scaled", "clipped", "cached", "self_doubting"}
    assert set(WRAPPERS) == shipped


def test_corruption_follows_from_the_image_and_can_be_undone(images) -> None:
    plain, corrupted = LeftRight(), AffineCorrupted(LeftRight(), seed=3)
    before, after = 1 / plain(images).depth.flatten(1), 1 / corrupted(images).depth.flatten(1)
    for x, y in zip(before.detach().numpy(), after.detach().numpy(), strict=True):
        straight = y > 1.01 * y.min()
        assert np.abs(np.polyval(np.polyfit(x[straight], y[straight], 1), x[straight]) - y[straight]).max() < 1e-4
    assert torch.allclose(after[1], 1 / corrupted(images[1:]).depth.flatten(1)[0])
    assert not torch.allclose(after, 1 / AffineCorrupted(plain, seed=4)(images).depth.flatten(1))
    assert corrupted.depth_kind == "affine_disparity"
    assert Scaled(corrupted, 2.0).depth_kind == "affine_disparity", "no factor makes it metric"


def test_metric_goes_on_to_declare_the_kind() -> None:
    class Metres(LeftRight):
        metric = True

    network = Metres()
    assert (network.metric, network.depth_kind) == (True, "metric")
    network.metric = False
    assert (network.metric, network.depth_kind) == (False, "scale")


def test_self_doubt_grows_with_distance_and_where_the_mirror_image_disagrees(images) -> None:
    image = (255 * images[0].permute(1, 2, 0)).byte().numpy()
    alone, mirrored = (SelfDoubting(LeftRight(), mirror=mirror) for mirror in (False, True))
    (depth, plain), (same, doubt) = alone.predict_with_sigma(image), mirrored.predict_with_sigma(image)
    np.testing.assert_array_equal(depth, LeftRight().predict(image))
    np.testing.assert_array_equal(depth, same)
    assert plain[:, -5:].mean() > plain[:, :5].mean()  # the far side
    assert mirrored.estimator.calls == alone.estimator.calls == 1
    # In the middle of the picture both sides are said to be alike, and at its borders they are not.
    assert (doubt / plain)[:, [0, -1]].mean() > (doubt / plain)[:, 31:33].mean()
    assert mirrored.train()(images).sigma is None


def test_what_self_doubt_learnt_lies_beside_the_weights(tmp_path, images) -> None:
    taught = SelfDoubting(LeftRight()).eval()
    taught.sigma_head().scale(3.0)
    taught.save_weights(tmp_path)
    told = SelfDoubting(LeftRight(), learnt=tmp_path / SelfDoubting.FILE).eval()
    read = SelfDoubting(LeftRight()).eval()
    read.load_weights(tmp_path)
    LeftRight().load_weights(tmp_path)  # the network's own are read without it
    for other in (told, read):
        torch.testing.assert_close(other(images).sigma, taught(images).sigma, rtol=0, atol=0)
    with pytest.raises(WeightsError, match="no weight file"):
        SelfDoubting(LeftRight(), learnt=tmp_path / "none.pth")


class TwoScales(Constant):
    """Leaves out its coarse scale where only the finest is asked for; notes how often it did."""

    alone = 0

    def forward(self, images):
        depth = super().forward(images).depth
        if self.only_finest:
            self.alone += 1
            return DepthPrediction((depth,))
        return DepthPrediction((depth, depth[..., ::2, ::2]))


@pytest.mark.parametrize("wrappers", [[], ["flip_averaged", {"clipped": {"farthest": 7.0}}, "cached"]], ids=str)
def test_only_the_finest_scale_is_asked_for_within_the_block(wrappers, images) -> None:
    inner = TwoScales()
    network = wrap(inner, wrappers).eval()
    plain = network(images)
    with network.finest_scale():
        with pytest.raises(ZeroDivisionError), network.finest_scale():
            raise ZeroDivisionError
        assert len(network(images).depths) == 1  # leaving the inner block did not end the outer one
        assert torch.equal(network(images).depth, plain.depth)
    assert len(network(images).depths) == len(plain.depths) == 2
    inner.alone = 0
    network.predict(np.zeros((40, 70, 3), np.uint8))
    assert inner.alone == 1


def test_a_network_that_does_not_look_returns_all_as_always(images) -> None:
    network = LeftRight()
    plain = network(images)
    with network.finest_scale():
        assert torch.equal(network(images).depth, plain.depth)
