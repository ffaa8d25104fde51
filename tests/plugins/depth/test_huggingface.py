"""``depth=huggingface``: small models with random weights, of four architectures; nothing is downloaded."""

from __future__ import annotations

import json
import logging

import cv2
import numpy as np
import pytest
import torch

pytest.importorskip("transformers", reason="depth=huggingface comes with the extra 'hf'")

import prgbd
from prgbd.core.errors import ConfigError, WeightsError
from prgbd.plugins.depth.huggingface.inputs import input_rules
from prgbd.plugins.depth.huggingface.outputs import disparity_unit, meaning_of
from tests.contracts import DepthContract
from tests.plugins.depth.hf_models import MODELS, depth_anything, dpt

SIZE = {"height": 70, "width": 98}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    home = tmp_path_factory.mktemp("models")
    return {name: make(home / name) for name, make in MODELS.items()}


@pytest.fixture
def image():
    return np.random.default_rng(1).integers(0, 256, (90, 130, 3), dtype=np.uint8)


@pytest.mark.parametrize("name", MODELS)
class TestContract(DepthContract):
    @pytest.fixture
    def estimator(self, folders, name):
        return prgbd.make_depth("huggingface", model=folders[name], **SIZE)

    @pytest.fixture(autouse=True)
    def _parametrised(self, name):
        pass


@pytest.mark.parametrize(
    ("name", "metric"), [("depth_anything", False), ("dpt", False), ("glpn", True), ("zoedepth", True)]
)
def test_disparity_and_metric_depth_are_told_apart(folders, name, metric) -> None:
    network = prgbd.make_depth("huggingface", model=folders[name])
    assert network.metric is metric
    assert network.meaning.kind == ("depth" if metric else "disparity")
    assert network.depth_range[1] == {"glpn": 80.0, "zoedepth": 10.0}.get(name, 100.0)


def test_a_metric_depth_anything_gives_its_depth_as_it_is(tmp_path, image) -> None:
    network = prgbd.make_depth("huggingface", model=depth_anything(tmp_path, "metric"))
    assert network.metric
    assert network.depth_range == (0.1, 20.0)
    images = network.preprocess(image)[None]
    with torch.no_grad():
        raw = network.model(pixel_values=network.rules.normalise(images)).predicted_depth
        assert torch.allclose(network(images).depth[:, 0], raw.clamp(0.1, 20.0), rtol=1e-5)


def test_relative_disparity_is_inverted_with_the_far_end_at_zero(folders) -> None:
    network = prgbd.make_depth("huggingface", model=folders["depth_anything"], disparity_scale=0.25, max_depth=50.0)
    images = torch.rand((1, 3, 70, 70), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        raw = network.model(pixel_values=network.rules.normalise(images)).predicted_depth
        assert torch.allclose(1 / network(images).depth[:, 0], 0.25 * raw + 1 / 50, rtol=1e-4)
        network.model.head.conv3.weight.zero_()
        network.model.head.conv3.bias.fill_(-1.0)  # disparity zero: as far as can be
        assert torch.allclose(network(images).depth, torch.tensor(50.0))


def test_the_unit_of_disparity_does_not_depend_on_how_large_the_numbers_are(folders, image) -> None:
    network = prgbd.make_depth("huggingface", model=folders["dpt"])
    small = disparity_unit(lambda x: x.mean(1), 48, 64)
    assert disparity_unit(lambda x: 1000 * x.mean(1), 48, 64) == pytest.approx(1000 * small)
    assert disparity_unit(lambda x: 0 * x.mean(1), 48, 64) == 1.0
    near = network.predict((255 * torch.rand(64, 64, 3)).byte().numpy())
    assert 0.5 < near.min() < 8.0


def test_what_the_user_says_of_the_output_holds(folders) -> None:
    assert not prgbd.make_depth("huggingface", model=folders["glpn"], output="disparity").metric
    assert prgbd.make_depth("huggingface", model=folders["dpt"], output="depth").meaning.kind == "depth"
    with pytest.raises(ConfigError, match=r"depth\.output=depht"):
        prgbd.make_depth("huggingface", model=folders["dpt"], output="depht")

    class Unknown:
        model_type = "canopy"

    with pytest.raises(ConfigError, match="'canopy' give depth or disparity"):
        meaning_of(Unknown(), "auto")


@pytest.mark.parametrize("size", [(100, 80), (140, 210)])
def test_inputs_are_those_of_the_models_own_processor(folders, size) -> None:
    processors = pytest.importorskip("transformers.models.dpt.image_processing_pil_dpt")
    folder = folders["depth_anything"]
    reference = processors.DPTImageProcessorPil.from_pretrained(folder)
    # Smooth, as photographs are: PIL cuts overshoots off between its two passes.
    noise = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
    image = np.asarray(cv2.GaussianBlur(noise, (0, 0), 2.0))
    expected = torch.from_numpy(np.asarray(reference(images=image)["pixel_values"][0]))
    rules = input_rules("depth_anything", json.loads((folder / "preprocessor_config.json").read_text()), patch=14)
    chosen = rules.processor_size(*size)
    assert chosen == tuple(expected.shape[1:])
    network = prgbd.make_depth("huggingface", model=folder, height=chosen[0], width=chosen[1])
    given = network.rules.normalise(network.preprocess(image))
    # PIL rounds to whole grey levels in between.
    assert (given - expected).abs().max() < 2.5 / 255 / 0.224


def test_rules_without_a_processor_are_those_of_the_architecture(tmp_path) -> None:
    network = prgbd.make_depth("huggingface", model=depth_anything(tmp_path, processor=False))
    assert network.input_size == (518, 518)
    assert network.rules.multiple == 14
    assert input_rules("glpn", None).mean == (0.0, 0.0, 0.0)
    assert input_rules("dpt", {"size": 256, "do_normalize": False, "resample": 2}, 16).mode == "bilinear"
    assert input_rules("zoedepth", {"ensure_multiple_of": 1 / 32}, 16).multiple == 32


def test_any_size_goes_in_and_comes_out(folders) -> None:
    network = prgbd.make_depth("huggingface", model=folders["dpt"], height=50, width=75)
    images = torch.rand((2, 3, 50, 75), requires_grad=True)
    depth = network(images).depth
    assert depth.shape == (2, 1, 50, 75)
    depth.log().sum().backward()
    assert images.grad is not None
    assert images.grad.abs().sum() > 0  # the way in is differentiable as well


def test_a_squeezed_image_is_spoken_of_once(folders, caplog) -> None:
    network = prgbd.make_depth("huggingface", model=folders["depth_anything"])
    with caplog.at_level(logging.WARNING, "prgbd"):
        for _ in range(2):
            network.preprocess(np.zeros((50, 150, 3), np.uint8))
    assert len(caplog.records) == 1
    assert "depth.height=70 depth.width=210" in caplog.text


@pytest.mark.parametrize("name", ["depth_anything", "zoedepth"])
def test_saved_weights_predict_the_same_and_load_as_a_model_of_their_own(folders, tmp_path, image, name) -> None:
    network = prgbd.make_depth("huggingface", model=folders[name])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.mul_(1.05)
    expected = network.predict(image)
    network.save_weights(tmp_path / "refined")
    for options in ({"weights": tmp_path / "refined"}, {"model": folders[name], "weights": tmp_path / "refined"}):
        assert np.allclose(prgbd.make_depth("huggingface", **options).predict(image), expected, rtol=1e-5)


def test_prediction_before_training_does_not_hinder_it(folders, image) -> None:
    network = prgbd.make_depth("huggingface", model=folders["zoedepth"], checks=False)
    network.predict(image)  # in inference mode, and BEiT keeps tensors
    network.train()
    network(network.preprocess(image)[None]).depth.log().mean().backward()
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in network.parameters())


def test_it_learns(folders) -> None:
    network = prgbd.make_depth("huggingface", model=folders["depth_anything"])
    network.train()
    images = torch.rand((1, 3, 70, 70), generator=torch.Generator().manual_seed(0))
    truth = torch.linspace(20.0, 2.0, 70)[None, None, :, None].expand(1, 1, 70, 70)
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    errors = []
    for _ in range(25):
        error = (network(images).depth.log() - truth.log()).abs().mean()
        optimizer.zero_grad()
        error.backward()
        optimizer.step()
        errors.append(error.item())
    assert errors[-1] < 0.6 * errors[0]


def test_what_cannot_be_loaded_is_said_in_one_sentence(folders, tmp_path) -> None:
    from transformers import Dinov2Config

    with pytest.raises(ConfigError, match=r"needs depth\.model"):
        prgbd.make_depth("huggingface")
    with pytest.raises(WeightsError, match=r"There is no folder \./nowhere"):
        prgbd.make_depth("huggingface", model="./nowhere")
    with pytest.raises(WeightsError, match=r"has no config\.json"):
        prgbd.make_depth("huggingface", model=tmp_path)
    with pytest.raises(WeightsError, match="holds the weights of another network"):
        prgbd.make_depth("huggingface", model=folders["dpt"], weights=folders["glpn"])
    with pytest.raises(WeightsError, match="There is no weight file"):
        prgbd.make_depth("huggingface", model=folders["dpt"], weights=tmp_path)
    Dinov2Config().save_pretrained(tmp_path)
    with pytest.raises(WeightsError, match="'dinov2', which estimates no depth"):
        prgbd.make_depth("huggingface", model=tmp_path)
    cut = dpt(tmp_path / "cut")
    (cut / "model.safetensors").write_bytes((cut / "model.safetensors").read_bytes()[:1000])
    with pytest.raises(WeightsError, match="cannot be loaded"):
        prgbd.make_depth("huggingface", model=cut)
    with pytest.raises(ConfigError, match=r"depth\.max_depth=0\.05"):
        prgbd.make_depth("huggingface", model=folders["dpt"], max_depth=0.05)


def test_weights_that_lack_tensors_are_refused(tmp_path) -> None:
    from safetensors.torch import load_file, save_file

    folder = dpt(tmp_path / "model")
    state = load_file(folder / "model.safetensors")
    name = next(key for key in state if key.startswith("head."))
    save_file({k: v for k, v in state.items() if k != name}, folder / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(WeightsError, match="lack 1 tensors"):
        prgbd.make_depth("huggingface", model=folder)
