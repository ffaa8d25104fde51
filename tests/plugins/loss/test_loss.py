"""The built-in loss terms keep the contract of everybody's."""

import pytest
import torch

from prgbd import DepthPrediction, LossInputs, View, make_loss
from prgbd.core.errors import ContractError
from prgbd.core.registry import specs
from prgbd.core.testing.refinement_scene import refinement_scene
from tests.contracts import LossContract

OPTIONS = {
    "photometric": [{"automask": False}],
    "depth_consistency": [{"residual": "log"}],
    "depth_transfer": [{"matching": "offset", "reduction": "sum", "residual": "log"}, {"anchored": True, "patch": 1}],
}
EVERY = [(spec.id, {}) for spec in specs("loss") if spec.origin == "built-in"]
EVERY += [(term, options) for term, several in OPTIONS.items() for options in several]


class TestBuiltInTerms(LossContract):
    @pytest.fixture(params=EVERY, ids=str)
    def term(self, request):
        name, options = request.param
        return make_loss(name, **options)


def inputs(factor, views=tuple(View)):
    batch, depths = refinement_scene()
    prediction = DepthPrediction((torch.cat([depths[view] for view in views]) * factor,))
    return LossInputs(batch, views, prediction, torch.Generator().manual_seed(0))


@pytest.mark.parametrize("name", ["photometric", "depth_consistency", "depth_transfer"])
def test_the_truth_costs_least(name):
    term = make_loss(name)
    assert term(inputs(1.0)) < 0.7 * term(inputs(1.1))
    assert term(inputs(1.0)) < 0.7 * term(inputs(0.9))


def test_a_view_that_no_term_declares_has_no_depth():
    with pytest.raises(ContractError, match="KEYFRAME_1"):
        inputs(1.0, (View.CURRENT,)).depth(View.KEYFRAME_1)


def test_the_depth_of_a_view_is_its_own():
    everything, _ = inputs(1.0), refinement_scene()
    depths = refinement_scene()[1]
    for view in View:
        assert torch.equal(everything.depth(view), depths[view])
        assert everything.vTc(view).shape == (2, 4, 4)
    assert torch.equal(everything.current.depth, depths[View.CURRENT])
