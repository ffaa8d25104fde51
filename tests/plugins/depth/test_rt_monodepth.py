"""RT-MonoDepth-S: equal to the published network."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from prgbd import make_depth
from prgbd.core.errors import ConfigError, WeightsError
from prgbd.core.testing.conformance import check_depth_estimator
from prgbd.plugins.depth.rt_monodepth import RTMonoDepth

IMAGE = "kitti_raw/2011_09_26/2011_09_26_drive_0000_sync/image_02/data/0000000000.png"
SMALL = {"height": 64, "width": 96}


@pytest.mark.parametrize("kind", ["m", "ms"])
def test_disparities_are_the_published_networks(kind, golden: Path, shared_data):
    """Needs ../shared; without it ``test_disparities_of_made_weights_stay`` stands in."""
    expected = json.loads((golden / "rt_monodepth_s_reference.json").read_text())["disparity"][kind]
    network = RTMonoDepth(weights=shared_data(f"weights/rt_monodepth_s/{kind}_640_192")).eval()
    assert network.input_size == (192, 640)
    image = cv2.cvtColor(cv2.imread(str(shared_data(IMAGE))), cv2.COLOR_BGR2RGB)
    with torch.inference_mode():
        disparities = network(network.preprocess(image)[None]).disparities
    assert len(disparities) == 3
    for scale, disparity in enumerate(disparities):
        figures = expected[f"disp{scale}"]
        assert list(disparity.shape[2:]) == figures["shape"]
        assert disparity.mean().item() == pytest.approx(figures["mean"], abs=1e-5)
        for v, u, value in figures["samples"]:
            assert disparity[0, 0, v, u].item() == pytest.approx(value, abs=1e-5)


def test_disparities_of_made_weights_stay(tmp_path):
    """The figures were printed when the network was equal to the published one with the published weights."""
    network = RTMonoDepth(**SMALL)
    for parameter in network.parameters():
        chirp = torch.sin(0.1 * torch.arange(parameter.numel(), dtype=torch.float64) ** 2).view_as(parameter)
        size = 0.1 if parameter.ndim == 1 else (3.5 / parameter[0].numel()) ** 0.5
        parameter.data = (size * chirp).float()
    network.save_weights(tmp_path)
    network = RTMonoDepth(weights=tmp_path).eval()
    ramp = torch.linspace(0, 1, 64)[:, None] * torch.linspace(1, 0, 96)
    with torch.inference_mode():
        disparities = network(torch.stack([ramp, 1 - ramp, ramp.flip(0)])[None]).disparities
    expected = [
        (64, 96, 0.3184724, 0.5949560, 0.1666471),
        (32, 48, 0.6048120, 0.6205515, 0.6293499),
        (16, 24, 0.4902133, 0.5827402, 0.5516173),
    ]
    for disparity, (height, width, *values) in zip(disparities, expected, strict=True):
        assert disparity.shape == (1, 1, height, width)
        samples = disparity.mean(), disparity[0, 0, 3, 5], disparity[0, 0, -2, width // 2]
        assert [sample.item() for sample in samples] == pytest.approx(values, abs=1e-5)


def test_contract():
    check_depth_estimator(RTMonoDepth(**SMALL))


def test_scale_makes_depth_metric():
    image = np.random.default_rng(0).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    plain, scaled = RTMonoDepth(**SMALL), RTMonoDepth(**SMALL, scale=5.4)
    assert (plain.metric, scaled.metric) == (False, True)
    assert scaled.depth_range == pytest.approx((0.54, 540))
    np.testing.assert_allclose(scaled.predict(image), 5.4 * plain.predict(image), rtol=1e-5)


def test_weights_of_another_network_are_refused(tmp_path):
    network = RTMonoDepth(**SMALL)
    with pytest.raises(WeightsError, match=r"There is no .*encoder\.pth"):
        network.load_weights(tmp_path)
    for name in ("encoder.pth", "depth.pth"):
        torch.save({"decoder.0.conv.conv.weight": torch.zeros(1)}, tmp_path / name)
    with pytest.raises(WeightsError, match="another network than Encoder"):
        RTMonoDepth(weights=tmp_path)


@pytest.mark.parametrize("options", [{"scale": 0.0}, {"scale": -1.0}, {"height": 100}, {"max_depth": 0.01}])
def test_wrong_options_are_one_sentence(options):
    with pytest.raises(ConfigError, match=r"depth\."):
        make_depth("rt_monodepth", **options)


def test_within_finest_scale_the_finest_depth_is_the_same_and_alone():
    network = RTMonoDepth(**SMALL).eval()
    images = torch.rand((1, 3, 64, 96), generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        plain = network(images)
        with network.finest_scale():
            finest = network(images)
        assert torch.equal(finest.depth, plain.depth)
        assert (len(finest.depths), len(network(images).depths)) == (1, 3)
