"""Weight files that hold something other than the weights of their network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from prgbd import make_depth
from prgbd.core.errors import WeightsError
from tests.core.plugins import Constant
from tests.robustness.fuzzing import examples, judged

ENTRIES = st.sampled_from(
    [
        torch.tensor(3),
        torch.tensor(1j),
        torch.tensor(float("nan")),
        torch.tensor(float("-inf")),
        torch.tensor(True),
        torch.tensor(0.5, dtype=torch.float16),
        torch.tensor(0.5, dtype=torch.float64),
        torch.zeros(0),
        torch.zeros(2, 3),
        torch.eye(3).to_sparse(),
        torch.quantize_per_tensor(torch.ones(()), 0.1, 0, torch.qint8),
        {"nested": torch.zeros(())},
        [1.0],
        None,
        "text",
        10**30,
        float("nan"),
    ]
)
NAMES = st.sampled_from(["log_depth", "other", "", "log_depth.weight", 3, (1, 2)])


@examples(small=40, large=400)
@given(
    state=st.one_of(st.dictionaries(NAMES, ENTRIES, max_size=3), ENTRIES, st.fixed_dictionaries({"log_depth": ENTRIES}))
)
def test_state_dicts(tmp_path_factory: pytest.TempPathFactory, state: Any) -> None:
    path = tmp_path_factory.getbasetemp() / "weights.pth"
    torch.save(state, path)
    network = Constant()
    with judged("weight files: entries"):
        network.load_weights(path)
        assert torch.isfinite(network.log_depth)


@examples(small=40, large=400)
@given(content=st.binary(max_size=200), at=st.integers(0, 2000))
def test_damaged_bytes(tmp_path_factory: pytest.TempPathFactory, content: bytes, at: int) -> None:
    path = tmp_path_factory.getbasetemp() / "weights.pth"
    Constant().save_weights(path.parent / "sound")
    whole = (path.parent / "sound" / Constant.weights_file).read_bytes()
    path.write_bytes(whole[:at] + content)
    with judged("weight files: bytes"):
        Constant().load_weights(path)


@pytest.mark.parametrize("plugin", ["monodepth2", "rt_monodepth"])
@pytest.mark.parametrize("size", [0, -64, 1.5, float("nan"), "large", None, 10**30, torch.zeros(3)])
def test_sizes_that_are_none(plugin: str, size: object, tmp_path: Path) -> None:
    network = make_depth(plugin)
    network.save_weights(tmp_path)
    state = torch.load(tmp_path / "encoder.pth", weights_only=True)
    torch.save({**state, "height": size, "width": 640}, tmp_path / "encoder.pth")
    with pytest.raises(WeightsError, match=r"encoder\.pth says that its input size is"):
        network.load_weights(tmp_path)


@pytest.mark.parametrize("plugin", ["monodepth2", "rt_monodepth"])
def test_networks_of_several_files_read_them_the_same_way(plugin: str, tmp_path: Path) -> None:
    network = make_depth(plugin)
    network.save_weights(tmp_path)
    state = torch.load(tmp_path / "depth.pth", weights_only=True)
    name = next(iter(state))
    for change, words in ((lambda v: v.long(), "int64"), (lambda v: v + 0j, "complex64"), (lambda v: v / 0, "NaN")):
        torch.save({**state, name: change(state[name])}, tmp_path / "depth.pth")
        with pytest.raises(WeightsError, match=rf"depth\.pth has an entry {name} that holds {words}"):
            network.load_weights(tmp_path)
