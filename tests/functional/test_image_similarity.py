"""The photometric error and its written-out gradient against a plain one with average pooling and autograd."""

import torch
import torch.nn.functional as F

from prgbd.functional import image_similarity as similarity


def plain_error(a, b):
    """The same as Monodepth2 computes it."""
    pa, pb = (F.pad(x, (1, 1, 1, 1), mode="reflect") for x in (a, b))
    ma, mb = F.avg_pool2d(pa, 3, 1), F.avg_pool2d(pb, 3, 1)
    va, vb = F.avg_pool2d(pa**2, 3, 1) - ma**2, F.avg_pool2d(pb**2, 3, 1) - mb**2
    cov = F.avg_pool2d(pa * pb, 3, 1) - ma * mb
    s = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    structure = ((1 - s) / 2).clamp(0, 1).mean(1, keepdim=True)
    return 0.85 * structure + 0.15 * (a - b).abs().mean(1, keepdim=True)


def images(dtype=torch.float64, size=(7, 9)):
    generator = torch.Generator().manual_seed(0)
    return (torch.rand(2, 3, *size, generator=generator, dtype=dtype) for _ in range(2))


def test_value_and_gradient_are_those_of_the_plain_error():
    a, b = images()
    a.requires_grad_()
    weights = torch.rand(2, 1, 7, 9, dtype=torch.float64)
    ours, theirs = similarity.photometric_error(a, b), plain_error(a, b)
    assert torch.allclose(ours, theirs, atol=1e-12)
    gradients = [torch.autograd.grad((weights * y).sum(), a)[0] for y in (ours, theirs)]
    assert torch.allclose(*gradients, atol=1e-10)


def test_the_gradient_agrees_with_finite_differences_up_to_the_smallest_image():
    for size in ((2, 2), (2, 5), (4, 3)):
        a, b = images(size=size)
        assert torch.autograd.gradcheck(lambda x, b=b: similarity.photometric_error(x, b), a.requires_grad_())


def test_float32_is_as_close_as_its_digits():
    a, b = images(size=(40, 50))
    exact = plain_error(a, b)
    assert (similarity.photometric_error(a.float(), b.float()) - exact).abs().max() < 1e-4


def test_equal_images_have_no_error_and_no_gradient():
    a, _ = images(torch.float32)
    x = a.clone().requires_grad_()
    error = similarity.photometric_error(x, a)
    assert error.abs().max() < 1e-5
    assert torch.autograd.grad(error.sum(), x)[0].abs().max() < 1e-2


def test_moments_may_be_given():
    a, b = images()
    given = similarity.photometric_error(a, b, similarity.moments(b))
    assert torch.equal(given, similarity.photometric_error(a, b))
