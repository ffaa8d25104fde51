"""The built-in augmentations keep the contract of everybody's."""

import pytest
import torch

from prgbd import make_augmentation
from prgbd.core.registry import specs
from prgbd.core.testing.refinement_scene import refinement_scene
from prgbd.training.objective import make_augmentations
from tests.contracts import AugmentationContract


class TestBuiltInAugmentations(AugmentationContract):
    @pytest.fixture(params=[spec.id for spec in specs("augmentation") if spec.origin == "built-in"])
    def augmentation(self, request):
        return make_augmentation(request.param)


def test_mirrored_twice_is_as_it_was():
    batch, _ = refinement_scene()
    batch = batch._replace(altered=batch.images**2)
    mirror, both = make_augmentation("mirror"), torch.ones(2, dtype=torch.bool)
    once = mirror.augment(batch, both, torch.Generator())
    twice = mirror.augment(once, both, torch.Generator())
    for name, before in batch._asdict().items():
        assert torch.allclose(getattr(twice, name), before, atol=1e-5), name
        assert torch.equal(getattr(once, name), before) == (name in {"depth", "mask", "seen_depth", "seen_mask"})
    assert torch.equal(once.altered, once.images**2)


def test_jitter_changes_what_the_network_sees_and_not_what_the_terms_compare():
    batch, _ = refinement_scene()
    out = make_augmentation("jitter").augment(batch, torch.tensor([True, False]), torch.Generator().manual_seed(0))
    assert out.images is batch.images
    assert not torch.equal(out.inputs[0], batch.images[0])
    assert torch.equal(out.inputs[1], batch.images[1])


def test_the_probability_is_the_share_of_the_samples():
    batch, _ = refinement_scene(samples=200)
    out = make_augmentation("mirror", probability=0.25)(batch, torch.Generator().manual_seed(1))
    changed = (out.uv != batch.uv).flatten(1).any(1)
    assert 30 < changed.sum() < 70


def test_augment_true_is_mirror_and_jitter_and_a_node_alone_is_itself():
    def names(*arguments):
        return [type(getattr(a, "unwrapped", a)).__name__ for a in make_augmentations(*arguments)]

    assert names({}, True) == ["Mirror", "Jitter"]
    assert names({"jitter": {"strength": 0.5}}) == ["Jitter"]
    assert names({"jitter": {"strength": 0.5}}, True) == ["Mirror", "Jitter"]
    assert names({"mirror": 0.0}, True) == ["Jitter"]
    assert names({"soft": {"id": "jitter", "strength": 0.1}}, True) == ["Mirror", "Jitter", "Jitter"]
    assert names({}) == []
