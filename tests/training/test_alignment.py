"""Predictions that lack scale and shift, aligned with SLAM's points."""

import pytest
import torch

from prgbd.core.errors import ConfigError
from prgbd.core.refinement_batch import RefinementBatch, View
from prgbd.core.types import DepthPrediction
from prgbd.training.alignment import aligned

VIEWS = (View.CURRENT, View.KEYFRAME_1, View.KEYFRAME_2)


@pytest.fixture
def scene():
    """True depth of three keyframes of two samples, (6, 1, 8, 12), one view after the other, and a batch of points."""
    random = torch.Generator().manual_seed(0)
    truth = 1 + 9 * torch.rand((6, 1, 8, 12), generator=random)
    v, u = torch.meshgrid(torch.arange(8.0), torch.arange(12.0), indexing="ij")
    uv = torch.stack([u.flatten(), v.flatten()], 1)
    eye = torch.eye(4).expand(2, 2, 4, 4)
    depth = truth.view(3, 2, -1).transpose(0, 1)
    batch = RefinementBatch(
        images=torch.zeros(2, 5, 3, 8, 12),
        K=torch.eye(3).expand(2, 3, 3),
        aTc=eye,
        kTc=eye,
        uv=uv.expand(2, 3, -1, 2)[:, :, :50],
        depth=depth[:, :, :50],
        mask=torch.ones(2, 50, dtype=torch.bool),
        seen_uv=uv.expand(2, -1, 2),
        seen_depth=depth[:, 0],
        seen_mask=torch.ones(2, 96, dtype=torch.bool),
    )
    return truth, batch


def test_every_image_gets_its_own_scale_and_shift(scene) -> None:
    truth, batch = scene
    scale = torch.tensor([0.5, 1.0, 2.0, 0.7, 1.4, 3.0])[:, None, None, None]
    shift = torch.tensor([0.1, 0.0, 0.2, 0.3, 0.05, 0.15])[:, None, None, None]
    predicted = 1 / (scale * (1 / truth + shift))
    found = aligned(DepthPrediction((predicted,), sigma=torch.full_like(predicted, 0.1)), batch, VIEWS)
    assert torch.allclose(found.depth, truth, rtol=0.1)
    assert found.sigma is not None
    assert torch.allclose(found.sigma, 0.1 * (1 / truth + shift) * truth, rtol=0.2), "inverse depth errs as before"


def test_only_keyframes_can_be_aligned(scene) -> None:
    truth, batch = scene
    with pytest.raises(ConfigError, match="BEFORE"):
        aligned(DepthPrediction((truth,)), batch, (View.CURRENT, View.BEFORE, View.AFTER))
