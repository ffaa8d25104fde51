"""Augmentation of refinement batches: mirroring, which the geometry follows, and colour jitter, which it does not."""

from __future__ import annotations

import torch
from torch import Tensor

from prgbd.training.refinement_data import RefinementBatch

BRIGHTNESS, CONTRAST, SATURATION, HUE = 0.2, 0.2, 0.2, 0.1


def mirrored(batch: RefinementBatch, which: Tensor) -> RefinementBatch:
    """Mirror some samples left to right, with their cameras, poses and keypoints.

    Args:
        batch: Float images.
        which: (B,) bool.

    Returns:
        The same scene as a mirror shows it: all loss terms agree for mirrored depth maps.
    """
    width = batch.images.shape[-1]
    images = torch.where(which[:, None, None, None, None], batch.images.flip(-1), batch.images)
    K = batch.K.clone()
    K[:, 0, 2] = torch.where(which, width - 1 - K[:, 0, 2], K[:, 0, 2])
    # x -> -x on both sides of a transform turns the signs of its first row and column, the corner's twice.
    sign = batch.K.new_ones(4, 4)
    sign[0, 1:] = sign[1:, 0] = -1
    signs = torch.where(which[:, None, None, None], sign, torch.ones_like(sign))
    uv = batch.uv.clone()
    uv[..., 0] = torch.where(which[:, None, None], width - 1 - uv[..., 0], uv[..., 0])
    seen_uv = batch.seen_uv.clone()
    seen_uv[..., 0] = torch.where(which[:, None], width - 1 - seen_uv[..., 0], seen_uv[..., 0])
    return batch._replace(images=images, K=K, aTc=batch.aTc * signs, kTc=batch.kTc * signs, uv=uv, seen_uv=seen_uv)


def jittered(images: Tensor, which: Tensor, generator: torch.Generator) -> Tensor:
    """Jitter the colours of some samples, all images of a sample alike (Monodepth2: .2, .2, .2, .1).

    Args:
        images: (B, V, 3, H, W) float in [0, 1].
        which: (B,) bool.
        generator: Random numbers, on the CPU.

    Returns:
        (B, V, 3, H, W) in [0, 1].
    """
    count = images.shape[0]
    amounts = torch.tensor([BRIGHTNESS, CONTRAST, SATURATION, HUE])
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


def augmented(batch: RefinementBatch, generator: torch.Generator) -> tuple[RefinementBatch, Tensor]:
    """Mirror half of the samples and jitter half.

    Args:
        batch: Float images.
        generator: Random numbers, on the CPU.

    Returns:
        The mirrored batch, whose images the warps take, and the jittered images that the network sees.
    """
    flips, jitters = (torch.rand(2, batch.images.shape[0], generator=generator) < 0.5).to(batch.images.device)
    batch = mirrored(batch, flips)
    return batch, jittered(batch.images, jitters, generator)
