"""Colour jitter."""

import torch

from prgbd.functional.colour import jittered


def test_jitter_is_shared_by_the_images_of_a_sample_and_stays_in_range():
    images = torch.rand(3, 5, 3, 6, 8)
    images[:, 1:] = images[:, :1]
    out = jittered(images, torch.tensor([True, False, True]), torch.Generator().manual_seed(0))
    assert torch.equal(out[1], images[1])
    assert out.min() >= 0
    assert out.max() <= 1
    assert 0.02 < (out[0] - images[0]).abs().mean() < 0.3
    # Contrast and saturation act about the mean of each image; equal images stay equal.
    assert torch.allclose(out[0], out[0, :1].expand_as(out[0]), atol=1e-6)


def test_strength_scales_the_jitter_and_none_leaves_the_images():
    images, which = torch.rand(2, 1, 3, 6, 8), torch.ones(2, dtype=torch.bool)
    none, half, full = (
        (jittered(images, which, torch.Generator().manual_seed(3), s) - images).abs().mean() for s in (0.0, 0.5, 1.0)
    )
    assert none < 1e-6
    assert 0.3 * full < half < 0.8 * full
