"""A small Depth Anything through the whole loop: it is refined, stored, loaded, and predicts the same."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("transformers", reason="depth=huggingface comes with the extra 'hf'")

import prgbd
from tests.plugins.depth.hf_models import depth_anything


def test_the_loop_refines_it_and_its_weights_can_be_used_again(run, tmp_path):
    model = depth_anything(tmp_path / "model")
    parts = ("slam=test/sideways", "depth=huggingface", f"depth.model={model}", "data=test/wall")
    options = ("training.learning_rate=1e-3", "task.max_loops=1", "task.min_improvement=null")
    summary = run(*options, fakes=parts)
    assert summary["depth"] == "huggingface"
    assert len(summary["loops"]) == 2
    stored = next(path.parent for path in Path("run").rglob("config.json"))
    image = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    refined = prgbd.make_depth("huggingface", weights=stored).predict(image)
    again = prgbd.make_depth("huggingface", model=model, weights=stored).predict(image)
    assert np.array_equal(refined, again)
    assert not np.allclose(refined, prgbd.make_depth("huggingface", model=model).predict(image), rtol=1e-6)
