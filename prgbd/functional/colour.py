"""Colour jitter: brightness, contrast, saturation and hue of images, as Monodepth2 draws them."""

from __future__ import annotations

import torch
from torch import Tensor

BRIGHTNESS, CONTRAST, SATURATION, HUE = 0.2, 0.2, 0.2, 0.1


def jittered(images: Tensor, which: Tensor, generator: torch.Generator, strength: float = 1.0) -> Tensor:
    """Jitter the colours of some samples, all images of a sample alike (Monodepth2: .2, .2, .2, .1).

    Args:
        images: (B, V, 3, H, W) float in [0, 1].
        which: (B,) bool.
        generator: Random numbers, on the CPU.
        strength: Factor on the ranges; 1 is Monodepth2's.

    Returns:
        (B, V, 3, H, W) in [0, 1].
    """
    count = images.shape[0]
    amounts = strength * torch.tensor([BRIGHTNESS, CONTRAST, SATURATION, HUE])
    draws = ((2 * torch.rand(count, 4, generator=generator) - 1) * amounts).to(images)
    brightness, contrast, saturation = (1 + draws[:, i, None, None, None, None] for i in range(3))
    out = (images * brightness).clamp(0, 1)
    mean = grey(out).mean(dim=(-1, -2, -3), keepdim=True)
    out = (mean + (out - mean) * contrast).clamp(0, 1)
    out = (grey(out) + (out - grey(out)) * saturation).clamp(0, 1)
    out = hue_turned(out, draws[:, 3]).clamp(0, 1)
    return torch.where(which[:, None, None, None, None], out, images)


def grey(images: Tensor) -> Tensor:
    """Luminance (ITU-R 601) of (..., 3, H, W), with one channel."""
    weights = images.new_tensor([0.299, 0.587, 0.114])[:, None, None]
    return (images * weights).sum(dim=-3, keepdim=True)


def hue_turned(images: Tensor, turn: Tensor) -> Tensor:
    """Turn the hue of (B, V, 3, H, W) by ``turn`` (B,) of a full circle: a rotation of RGB about the grey axis."""
    angle = 2 * torch.pi * turn[:, None, None]
    axis = images.new_full((3,), 3**-0.5)
    cross = torch.linalg.cross(axis.expand(3, 3), torch.eye(3, dtype=images.dtype, device=images.device)).T
    eye = torch.eye(3, dtype=images.dtype, device=images.device)
    rotation = torch.cos(angle) * eye + torch.sin(angle) * cross + (1 - torch.cos(angle)) * torch.outer(axis, axis)
    return torch.einsum("bij,bvjhw->bvihw", rotation, images)
