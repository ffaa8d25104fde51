"""The scale and the shift that bring a predicted inverse depth to a known one (Ranftl et al., TPAMI 2022)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

# Error of inverse depth: in proportion to it, and a share of the image's mean that even what is far errs by.
_ABSOLUTE = 0.1
# What being near to scale 1 and shift 0 counts, in points: an image with few of them stays almost as it is.
_PRIOR = 1.0
# The least scale: an image whose prediction contradicts its points altogether is not turned inside out.
_LEAST_SCALE = 0.05


class AffineAlignment(NamedTuple):
    """``scale * inverse + shift`` per image.

    Attributes:
        scale: (B,) positive factors.
        shift: (B,) summands, in the unit of the known inverse depth.
        least: (B,) what an aligned inverse depth is at least, so that depth stays positive.
    """

    scale: Tensor
    shift: Tensor
    least: Tensor

    def depth(self, depth: Tensor) -> Tensor:
        """Return depth maps (B, 1, H, W) aligned."""
        scale, shift, least = (value[:, None, None, None] for value in self)
        return 1 / torch.maximum(scale / depth + shift, least)


def align_inverse_depth(predicted: Tensor, known: Tensor, mask: Tensor) -> AffineAlignment:
    """Fit ``scale * predicted + shift = known`` in each image by weighted least squares, in closed form.

    Gradients pass through the fit, so that a loss of aligned depth has none along scale and shift: what the network
    cannot know is not taught.

    Args:
        predicted: (B, N) predicted inverse depth of points.
        known: (B, N) their known inverse depth; anything where the mask is False.
        mask: (B, N) bool, real points.

    Returns:
        The alignment; scale 1 and shift 0 for an image without points.
    """
    known = torch.where(mask, known, torch.ones_like(known))
    count = mask.sum(1)
    middle = torch.where(mask, known, torch.zeros_like(known)).sum(1) / count.clamp(min=1)
    weight = mask / (known**2 + (_ABSOLUTE * middle[:, None]) ** 2)
    total = weight.sum(1)
    share = weight / total.clamp(min=torch.finfo(weight.dtype).tiny)[:, None]
    x, y = (share * predicted).sum(1), (share * known).sum(1)
    apart = predicted - x[:, None]
    spread = (share * apart**2).sum(1)
    together = (share * apart * (known - y[:, None])).sum(1)
    # Points that differ by a tenth of their mean tell a scale about as well as the prior does.
    prior = _PRIOR / count.clamp(min=1) * 0.01 * x**2
    some = count > 0
    ones = torch.ones_like(x)
    scale = torch.where(some, (together + prior) / torch.where(some, spread + prior, ones), ones)
    scale = scale.clamp(min=_LEAST_SCALE)
    known_share = count / (count + _PRIOR)
    shift = torch.where(some, known_share * (y - scale * x), torch.zeros_like(x))
    least = 0.01 * torch.where(some, middle, ones * 0.1)
    return AffineAlignment(scale, shift, least)
