"""Precision, layout and compilation of networks."""

import functools

import pytest
import torch

import prgbd
from prgbd.core.computing import Computing, compiled, computes_bfloat16
from prgbd.core.errors import ConfigError
from prgbd.plugins.depth.monodepth2 import Monodepth2
from prgbd.plugins.depth.rt_monodepth import RTMonoDepth

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def network():
    return Monodepth2(weights="demo", height=96, width=128).eval()


@pytest.fixture(scope="module")
def images(network):
    sequence = prgbd.make_data("synthetic", frames=2, width=256, height=192)
    return torch.stack([network.preprocess(frame.image) for frame in map(sequence.frame, range(2))])


def predict(network, images, computing):
    with computing.applied(network, CPU, print):
        return network(computing.arranged(images)).depth


def test_the_defaults_change_no_bit(network, images):
    with torch.inference_mode():
        plain = network(images).depth
    assert torch.equal(predict(network, images, Computing()), plain)
    assert Computing().description(CPU) == []


@pytest.mark.parametrize("name", ["monodepth2", pytest.param("rt_monodepth", marks=pytest.mark.shared)])
def test_bfloat16_gives_float32_depth_within_one_percent(name, network, images, request):
    """The second network needs its published weights in ../shared; the first brings its own."""
    if name == "rt_monodepth":
        weights = request.getfixturevalue("shared_data")("weights/rt_monodepth_s/m_640_192")
        network = RTMonoDepth(weights=weights, height=96, width=128).eval()
    plain = predict(network, images, Computing())
    half = predict(network, images, Computing("bfloat16", channels_last=True))
    assert half.dtype == torch.float32
    difference = (half / plain - 1).abs()
    assert difference.mean() < 0.005
    assert difference.flatten().kthvalue(int(0.95 * difference.numel())).values < 0.02
    # The digits of the last layers are those of float32: bfloat16 would leave a few hundred values.
    assert len(half.unique()) > 0.5 * half.numel()
    assert torch.equal(half, predict(network, images, Computing("bfloat16", channels_last=True)))


def test_channels_last_changes_the_last_digits_at_most(network, images):
    plain, other = (predict(network, images, Computing(channels_last=last)) for last in (False, True))
    assert torch.allclose(plain, other, rtol=1e-4)


@pytest.mark.parametrize("last", [False, True])
def test_images_are_stacked_in_the_chosen_layout(network, images, last):
    computing = Computing(channels_last=last)
    stacked = computing.stacked(list(images))
    assert torch.equal(stacked, images)
    assert stacked.stride() == computing.arranged(images).stride()


def test_weights_have_the_channels_innermost_within_the_block_alone(network, images):
    conv = next(m for m in network.modules() if isinstance(m, torch.nn.Conv2d) and m.in_channels > 1)
    with Computing(channels_last=True).applied(network, CPU, print):
        assert conv.weight.is_contiguous(memory_format=torch.channels_last)
    assert conv.weight.is_contiguous()
    with pytest.raises(ZeroDivisionError), Computing(channels_last=True).applied(network, CPU, print):
        raise ZeroDivisionError
    assert conv.weight.is_contiguous()


def test_auto_is_bfloat16_where_the_processor_has_it(monkeypatch):
    for supported, dtype in ((True, torch.bfloat16), (False, torch.float32)):
        monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda supported=supported: supported)
        monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
        assert Computing("auto").dtype(CPU) == dtype
    monkeypatch.delattr(torch.cpu, "_is_avx512_bf16_supported")
    assert not computes_bfloat16(CPU)
    assert not computes_bfloat16(torch.device("meta"))
    assert Computing("bfloat16").dtype(CPU) == torch.bfloat16


def test_what_differs_from_the_defaults_is_described():
    assert Computing("bfloat16", True, True).description(CPU) == ["torch.bfloat16", "channels_last", "compile"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"precision": "bf16"}, r"sensing\.precision is 'bf16'; it must be auto"),
        ({"precision": 16}, r"sensing\.precision is 16"),
        ({"channels_last": "yes"}, r"sensing\.channels_last is 'yes'; it must be true or false"),
        ({"compile": 1}, r"sensing\.compile is 1"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        Computing(**options)


class Small(torch.nn.Module):
    """Enough to be compiled."""

    def __init__(self):
        super().__init__()
        self.conv = torch.nn.Conv2d(3, 4, 3)

    def forward(self, images):
        return self.conv(images).exp()


def compile_with(monkeypatch, backend):
    monkeypatch.setattr(torch, "compile", functools.partial(torch.compile, backend=backend))


def test_a_compiled_network_is_the_same_network(monkeypatch):
    network, images, seen, said, graphs = Small(), torch.rand(2, 3, 8, 9), [], [], []
    plain = network(images)
    network.register_forward_hook(lambda *_: seen.append(1))
    compile_with(monkeypatch, lambda graph, inputs: graphs.append(graph) or graph.forward)
    with Computing(compile=True).applied(network, CPU, said.append):
        assert torch.allclose(network(images), plain, rtol=1e-5)
    assert (said, len(seen), len(graphs)) == ([], 1, 1)
    assert "forward" not in vars(network)


def test_without_a_compiler_the_network_is_computed_as_it_is(monkeypatch):
    def broken(graph, inputs):
        raise RuntimeError("no compiler")

    network, images, said = Small(), torch.rand(2, 3, 8, 9), []
    plain = network(images)
    compile_with(monkeypatch, broken)
    with compiled(network, said.append):
        assert all(torch.equal(network(images), plain) for _ in range(2))
    assert len(said) == 1
    assert "Small cannot be compiled" in said[0]
    assert "install a C++ compiler" in said[0]


def test_an_error_of_the_network_is_not_taken_for_one_of_the_compiler(monkeypatch):
    compile_with(monkeypatch, "eager")
    network, said = Small(), []
    with pytest.raises(RuntimeError), compiled(network, said.append):
        network(torch.rand(1, 5, 8, 8))
    assert said == []


def test_a_network_compiled_before_and_within_finest_scale_gives_what_is_asked_for(monkeypatch, network, images):
    compile_with(monkeypatch, "eager")
    said = []
    with Computing(compile=True).applied(network, CPU, said.append):
        plain = network(images)
        with network.finest_scale():
            finest = network(images)
        assert torch.equal(finest.depth, plain.depth)
        assert [len(p.depths) for p in (plain, finest, network(images))] == [4, 1, 4]
    assert said == []
