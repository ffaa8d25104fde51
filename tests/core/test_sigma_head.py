"""``SigmaHead``: log-linear in features, without a gradient."""

from __future__ import annotations

import pytest
import torch

from prgbd.core.sigma_head import LARGEST, SMALLEST, START, SigmaHead


@pytest.fixture
def features():
    generator = torch.Generator().manual_seed(0)
    return [torch.randn((2, c, 16 // s, 24 // s), generator=generator) for c, s in ((3, 1), (5, 2))]


@pytest.fixture
def head():
    head = SigmaHead([3, 5])
    head.assign(0.2 * torch.randn(8, generator=torch.Generator().manual_seed(1)), -1.5)
    return head


def test_a_fresh_head_says_the_same_everywhere(features):
    sigma = SigmaHead([3, 5])(features)
    assert sigma.shape == (2, 1, 16, 24)
    torch.testing.assert_close(sigma, torch.full_like(sigma, START))


def test_what_it_says_at_sampled_features_is_what_its_map_says_there(head, features):
    features = [features[0], torch.nn.functional.avg_pool2d(features[0], 2)[:, [0, 1, 2, 0, 1]]]
    uv = torch.tensor([[[3.0, 4.0], [20.0, 9.0], [0.0, 0.0]]]).expand(2, -1, -1)
    there = torch.stack([head(features)[:, 0, int(v), int(u)] for u, v in uv[0]], dim=1)
    torch.testing.assert_close(head.at(head.sampled(features, uv)), there, rtol=1e-5, atol=0)


def test_a_factor_multiplies_and_a_reset_forgets(head, features):
    before = head(features)
    head.scale(0.7)
    torch.testing.assert_close(head(features), 0.7 * before)
    head.reset()
    torch.testing.assert_close(head(features), torch.full_like(before, START))


def test_it_stays_within_limits_and_passes_no_gradient(head, features):
    wild = [(1000 * maps).requires_grad_() for maps in features]
    sigma = head(wild)
    assert float(sigma.min()) == pytest.approx(SMALLEST)
    assert float(sigma.max()) == pytest.approx(LARGEST)
    assert not sigma.requires_grad
    assert not any(parameter.requires_grad for parameter in head.parameters())


def test_half_precision_around_it_changes_nothing(head, features):
    with torch.autocast("cpu", torch.bfloat16):
        inside = head(features)
    torch.testing.assert_close(inside, head(features), rtol=0, atol=0)
