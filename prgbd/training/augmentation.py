"""Augmentation of refinement batches: mirroring, which the geometry follows, and colour jitter, which it does not."""

from __future__ import annotations

import torch
from torch import Tensor

from prgbd.functional.colour import jittered
from prgbd.training.refinement_data import RefinementBatch


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
