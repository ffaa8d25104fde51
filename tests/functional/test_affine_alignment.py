"""Scale and shift of predicted inverse depth, in closed form."""

import pytest
import torch

from prgbd.functional.affine_alignment import align_inverse_depth


@pytest.fixture
def known():
    return torch.rand((3, 40), generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 0.2


def everything(known):
    return torch.ones_like(known, dtype=torch.bool)


def test_it_finds_scale_and_shift(known) -> None:
    scale, shift = torch.tensor([0.5, 1.0, 3.0])[:, None], torch.tensor([0.1, 0.0, -0.3])[:, None]
    fit = align_inverse_depth((known - shift) / scale, known, everything(known))
    aligned = fit.scale[:, None] * (known - shift) / scale + fit.shift[:, None]
    assert torch.allclose(aligned, known, rtol=0.15)
    assert torch.allclose(fit.scale, scale[:, 0].double(), rtol=0.1)


def test_padding_and_empty_images(known) -> None:
    mask = everything(known)
    mask[0, 30:] = False
    mask[1] = False
    padded = torch.where(mask, known, torch.full_like(known, torch.nan))
    fit = align_inverse_depth(2 * known, padded, mask)
    alone = align_inverse_depth(2 * known[:1, :30], known[:1, :30], mask[:1, :30])
    assert torch.allclose(fit.scale[:1], alone.scale)
    assert (fit.scale[1], fit.shift[1]) == (1, 0)


def test_gradients(known) -> None:
    mask = everything(known)
    predicted = (0.7 * known + 0.1 * torch.sin(9 * known) + 0.2).requires_grad_()

    def depth(inverse):
        fit = align_inverse_depth(inverse, known, mask)
        return fit.depth((1 / inverse)[:, None, None])

    assert torch.autograd.gradcheck(depth, (predicted,))


def test_a_loss_of_aligned_depth_teaches_neither_scale_nor_shift(known) -> None:
    predicted = (0.7 * known + 0.1 * torch.sin(9 * known) + 0.2).requires_grad_()
    fit = align_inverse_depth(predicted, known, everything(known))
    loss = (fit.scale[:, None] * predicted + fit.shift[:, None] - known).abs().sum(1)
    (gradient,) = torch.autograd.grad(loss.sum(), predicted)
    size = gradient.abs().sum(1)
    assert (gradient.sum(1).abs() < 0.2 * size).all()
    assert ((gradient * predicted).sum(1).abs() < 0.2 * size).all()


def test_depth_stays_positive(known) -> None:
    fit = align_inverse_depth(1.2 - known, known, everything(known))
    assert (fit.scale > 0).all()
    assert (fit.depth(torch.full((3, 1, 2, 2), 1e6, dtype=torch.float64)) > 0).all()
