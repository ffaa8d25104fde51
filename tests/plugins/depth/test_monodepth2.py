"""Monodepth2: equal to the published networks, and reads and writes their files."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch

import prgbd
from prgbd.core.errors import ConfigError, WeightsError
from prgbd.core.sigma_head import START
from prgbd.core.testing.conformance import check_depth_estimator
from prgbd.plugins.depth.monodepth2 import Monodepth2
from prgbd.plugins.depth.monodepth2.decoder import Head, disparity_to_depth
from prgbd.plugins.depth.monodepth2.pose import rigid_transform

SMALL = {"height": 64, "width": 96}


@pytest.fixture(scope="module")
def reference(golden: Path) -> dict:
    return json.loads((golden / "monodepth2_reference.json").read_text())


def golden_entry(name: str, shape: list[int]) -> torch.Tensor:
    """A weight by the rule of the reference file; ``name`` has the prefix of its file."""
    if name.endswith("num_batches_tracked"):
        return torch.zeros((), dtype=torch.int64)
    n = np.random.default_rng([20201, zlib.crc32(name.encode())]).standard_normal(shape)
    if name.endswith("running_mean"):
        n = 0.1 * n
    elif name.endswith("running_var"):
        n = 1 + 0.1 * np.abs(n)
    elif len(shape) == 1:
        n = 1 + 0.1 * n if name.endswith("weight") else 0.05 * n
    else:
        n = 0.75 * n * np.sqrt(2 / np.prod(shape[1:]))
    return torch.from_numpy(n.astype(np.float32))


@pytest.fixture(scope="module")
def official(reference: dict, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of official-format files with the reference's deterministic weights."""
    folder = tmp_path_factory.mktemp("official")
    for file, entries in reference["state_dict_shapes"].items():
        prefix = file.removesuffix(".pth") + ":"
        state: dict = {name: golden_entry(prefix + name, shape) for name, shape in entries.items()}
        if file == "encoder.pth":
            state.update(height=192, width=640, use_stereo=False)
        torch.save(state, folder / file)
    return folder


@pytest.fixture(scope="module")
def network(official: Path) -> Monodepth2:
    network = Monodepth2(weights=official).eval()
    network.pose_network().eval()
    return network


@pytest.fixture(scope="module")
def images() -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(7)
    a, b = (torch.from_numpy(rng.random((1, 3, 192, 640)).astype(np.float32)) for _ in range(2))
    return a, b


def test_disparities_are_the_published_networks(network, reference, images):
    with torch.inference_mode():
        prediction = network(images[0])
    assert len(prediction.depths) == 4
    for scale, expected in reference["disparity_by_scale"].items():
        disparity = prediction.disparities[int(scale)]
        assert list(disparity.shape[2:]) == expected["shape"]
        assert disparity.mean().item() == pytest.approx(expected["mean"], abs=1e-5)
        assert disparity.std().item() == pytest.approx(expected["std"], abs=1e-5)
        for v, u, value in expected["samples"]:
            assert disparity[0, 0, v, u].item() == pytest.approx(value, abs=1e-5)
    expected = reference["disp_to_depth(0.1,100)"]
    depth = disparity_to_depth(prediction.disparities[0], 0.1, 100)
    torch.testing.assert_close(depth, prediction.depth)
    assert depth.mean().item() == pytest.approx(expected["depth_mean"], abs=1e-5)
    assert (1 / depth).mean().item() == pytest.approx(expected["scaled_disp_mean"], abs=1e-5)


def test_pose_is_the_published_networks(network, reference, images):
    expected = reference["pose"]
    with torch.inference_mode():
        axisangle, translation = network.pose_network().parameters_of_motion(*images)
        motion = network.pose_network()(*images)
    assert list(axisangle.shape) == expected["axisangle_shape"]
    np.testing.assert_allclose(axisangle.flatten(), expected["axisangle"], atol=1e-5)
    np.testing.assert_allclose(translation.flatten(), expected["translation"], atol=1e-5)
    torch.testing.assert_close(motion[:, :3, 3], translation[:, 0, 0])


def test_transforms_are_the_published_ones(reference):
    expected = reference["transformation_from_parameters"]
    vectors = torch.tensor([expected["axisangle"]]), torch.tensor([expected["translation"]])
    np.testing.assert_allclose(rigid_transform(*vectors)[0], expected["T"], atol=1e-6)
    np.testing.assert_allclose(rigid_transform(*vectors, invert=True)[0], expected["T_inverted"], atol=1e-6)
    torch.testing.assert_close(rigid_transform(torch.zeros(2, 3), torch.zeros(2, 3)), torch.eye(4).expand(2, 4, 4))


def test_rotation_has_a_gradient_at_zero():
    axisangle = torch.zeros(1, 3, requires_grad=True)
    rigid_transform(axisangle, torch.zeros(1, 3))[0, 2, 1].backward()
    assert torch.isfinite(axisangle.grad).all()


def test_files_are_laid_out_as_the_official_ones(network, reference, tmp_path):
    network.save_weights(tmp_path)
    for file, expected in reference["state_dict_shapes"].items():
        state = torch.load(tmp_path / file, weights_only=True)
        extra = {name: state.pop(name) for name in reference["extra_entries"].get(file, [])}
        assert {name: list(value.shape) for name, value in state.items()} == expected
        if file == "encoder.pth":
            assert extra == {"height": 192, "width": 640, "use_stereo": False}


def test_official_files_are_not_changed_by_reading_and_writing(network, official, tmp_path):
    network.save_weights(tmp_path)
    for path in official.iterdir():
        ours, theirs = (torch.load(p, weights_only=True) for p in (tmp_path / path.name, path))
        for name, value in theirs.items():
            assert torch.equal(ours[name], value) if isinstance(value, torch.Tensor) else ours[name] == value


def test_contract():
    check_depth_estimator(Monodepth2(**SMALL))


def test_half_precision_files_are_half_the_size_and_close(tmp_path):
    network = Monodepth2(**SMALL, seed=5).eval()
    network.save_weights(tmp_path / "full")
    network.save_weights(tmp_path / "half", half=True)
    full, half = ((tmp_path / kind / "encoder.pth").stat().st_size for kind in ("full", "half"))
    assert half < 0.51 * full
    assert not (tmp_path / "half" / "pose.pth").exists()
    again = Monodepth2(weights=tmp_path / "half").eval()
    assert again.input_size == (64, 96)
    assert {p.dtype for p in again.parameters()} == {torch.float32}
    image = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        torch.testing.assert_close(again(image).depth, network(image).depth, rtol=0.02, atol=0)


def test_size_of_the_files_gives_way_to_the_options(official):
    assert Monodepth2(weights=official).input_size == (192, 640)
    assert Monodepth2(weights=official, height=96, width=320).input_size == (96, 320)


@pytest.mark.parametrize(("height", "width"), [(72, 96), (80, 96), (88, 96), (64, 104), (80, 120)])
def test_sides_of_8_pixels_keep_their_scales_and_camera(height, width):
    """The depth of an image is that of the same image inside of its own mirrored border, cut out where it lay."""
    network = Monodepth2(height=height, width=width).eval()
    image = torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(0))
    border = [(-height) % 32, (-width) % 32]
    top, left = (lack // 16 * 8 for lack in border)
    around = torch.nn.functional.pad(image, (left, border[1] - left, top, border[0] - top), mode="reflect")
    with torch.inference_mode():
        prediction, larger = network(image), network(around)
    for scale, (depth, disparity) in enumerate(zip(prediction.depths, prediction.disparities, strict=True)):
        assert depth.shape == disparity.shape == (1, 1, height >> scale, width >> scale)
        v, u = top >> scale, left >> scale
        assert torch.equal(depth, larger.depths[scale][..., v : v + depth.shape[2], u : u + depth.shape[3]])
    assert network.pose_network()(image, image).shape == (1, 4, 4)


def test_sides_of_8_pixels_are_trained_and_stored(tmp_path):
    network = Monodepth2(height=72, width=80)
    network(torch.rand(2, 3, 72, 80)).depths[3].mean().backward()
    assert all(p.grad is not None for name, p in network.encoder.named_parameters() if ".fc." not in name)
    network.save_weights(tmp_path)
    assert Monodepth2(weights=tmp_path).input_size == (72, 80)


def test_seed_decides_the_fresh_network():
    first, again, other = (Monodepth2(**SMALL, seed=s).depth.decoder[3].conv.conv.weight for s in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_pose_network_is_kept_apart():
    network = Monodepth2(**SMALL)
    before = len(list(network.parameters()))
    pose = network.pose_network()
    assert network.pose_network() is pose
    assert len(list(network.parameters())) == before
    transform = pose(torch.rand(2, 3, 64, 96), torch.rand(2, 3, 64, 96))
    assert transform.shape == (2, 4, 4)


def test_imagenet_weights_start_both_encoders(tmp_path):
    torch.manual_seed(0)
    state = {k.removeprefix("encoder."): torch.rand_like(v.float()) for k, v in _encoder_state().items()}
    torch.save(state, tmp_path / "resnet18.pth")
    network = Monodepth2(**SMALL, imagenet_weights=tmp_path / "resnet18.pth")
    torch.testing.assert_close(network.encoder.encoder.conv1.weight, state["conv1.weight"])
    pose = network.pose_network().encoder.encoder.conv1.weight
    torch.testing.assert_close(pose, torch.cat([state["conv1.weight"]] * 2, 1) / 2)


def _encoder_state() -> dict[str, torch.Tensor]:
    return Monodepth2(**SMALL).encoder.state_dict()


def test_wrong_weights_are_one_sentence(tmp_path, official):
    with pytest.raises(WeightsError, match="There is no folder"):
        Monodepth2(weights=tmp_path / "nowhere")
    with pytest.raises(WeightsError, match=r"has no encoder\.pth"):
        Monodepth2(weights=tmp_path)
    for name in ("encoder.pth", "depth.pth"):
        (tmp_path / name).write_bytes((official / "depth.pth").read_bytes())
    with pytest.raises(WeightsError, match="another network than ResnetEncoder") as caught:
        Monodepth2(weights=tmp_path)
    assert "\n" not in str(caught.value)
    (tmp_path / "encoder.pth").write_bytes((official / "encoder.pth").read_bytes()[:1000])
    with pytest.raises(WeightsError, match="not a readable PyTorch weight file"):
        Monodepth2(weights=tmp_path)
    with pytest.raises(WeightsError, match="torchvision"):
        Monodepth2(imagenet_weights=official / "pose.pth")


@pytest.mark.parametrize(
    "options", [{"height": 100}, {"width": 0.5}, {"min_depth": 0}, {"weights": "x", "imagenet_weights": "y"}]
)
def test_wrong_options_are_one_sentence(options):
    with pytest.raises(ConfigError, match=r"depth\."):
        Monodepth2(**options)


def test_is_registered():
    assert type(prgbd.make_depth("monodepth2", **SMALL)).__name__ == "Monodepth2"


def test_a_head_is_the_same_whether_the_channels_are_innermost_or_not():
    head = Head(16)
    x = torch.randn(2, 16, 20, 30, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        by_columns = head(x.to(memory_format=torch.channels_last))
        torch.testing.assert_close(by_columns, head(x), rtol=0, atol=1e-5)
    assert head(x.to(memory_format=torch.channels_last)).requires_grad


def test_within_finest_scale_the_finest_depth_is_the_same_and_alone(network, images):
    with torch.inference_mode():
        plain = network(images[0])
        with network.finest_scale():
            finest = network(images[0])
        assert torch.equal(finest.depth, plain.depth)
        assert torch.equal(finest.disparities[0], plain.disparities[0])
        assert (len(finest.depths), len(finest.disparities)) == (1, 1)
        assert len(network(images[0]).depths) == len(plain.depths) == 4


def test_uncertainty_leaves_depth_as_it_is_and_is_stored_beside_it(tmp_path: Path) -> None:
    plain, headed = (Monodepth2(**SMALL, uncertainty=wanted).eval() for wanted in (None, True))
    image = np.random.default_rng(0).integers(0, 255, (64, 96, 3), dtype=np.uint8)
    depth, none = plain.predict_with_sigma(image)
    same, sigma = headed.predict_with_sigma(image)
    np.testing.assert_array_equal(depth, same)
    assert none is None
    np.testing.assert_allclose(sigma, START, rtol=1e-5)
    check_depth_estimator(headed)
    headed.sigma_head().assign(torch.linspace(-0.1, 0.1, 240), -2.0)
    headed.save_weights(tmp_path)
    expected = headed.predict_with_sigma(image)[1]
    assert expected.std() > 0
    for wanted, there in ((None, True), (True, True), (False, False)):
        read = Monodepth2(weights=tmp_path, uncertainty=wanted)
        again, told = read.predict_with_sigma(image)
        np.testing.assert_array_equal(again, depth)
        assert (told is not None) == there
        if told is not None:
            np.testing.assert_array_equal(told, expected)


def test_weights_without_uncertainty_get_a_head_that_knows_nothing(official: Path) -> None:
    network = Monodepth2(weights=official, uncertainty=True)
    network.sigma_head().scale(2.0)
    network.load_weights(official)
    image = np.zeros((64, 96, 3), np.uint8)
    np.testing.assert_allclose(network.predict_with_sigma(image)[1], START, rtol=1e-5)
    assert Monodepth2(weights=official).sigma_head() is None


def test_features_belong_to_the_image_where_a_margin_was_added(tmp_path: Path) -> None:
    network = Monodepth2(height=72, width=104, uncertainty=True).eval()
    images = torch.rand((1, 3, 72, 104), generator=torch.Generator().manual_seed(0))
    maps = network.sigma_features(images)
    assert [tuple(m.shape) for m in maps] == [(1, 16 << s, 72 >> s, 104 >> s) for s in range(4)]
    assert network(images).sigma.shape == (1, 1, 72, 104)


def test_the_demo_weights_know_how_wrong_they_are() -> None:
    head = prgbd.make_depth("monodepth2", weights="demo").sigma_head()
    assert head is not None
    assert float(head.weight.abs().sum()) > 0
