"""``mirror``: samples left to right, which the geometry follows."""

from __future__ import annotations

import torch
from torch import Tensor

from prgbd.core.augmentation import Augmentation
from prgbd.core.refinement_batch import RefinementBatch


class Mirror(Augmentation):
    """Mirrors samples left to right, with their cameras, motions and keypoints.

    Args:
        probability: Share of the samples that are mirrored.
    """

    def augment(self, batch: RefinementBatch, which: Tensor, generator: torch.Generator) -> RefinementBatch:
        """See ``Augmentation.augment``; all loss terms agree for mirrored depth maps."""
        width = batch.images.shape[-1]

        def mirrored(images: Tensor) -> Tensor:
            return torch.where(which[:, None, None, None, None], images.flip(-1), images)

        def column(u: Tensor) -> Tensor:
            return torch.where(which.view(-1, *(1 for _ in u.shape[1:])), width - 1 - u, u)

        K, uv, seen_uv = batch.K.clone(), batch.uv.clone(), batch.seen_uv.clone()
        K[:, 0, 2] = column(K[:, 0, 2])
        uv[..., 0] = column(uv[..., 0])
        seen_uv[..., 0] = column(seen_uv[..., 0])
        # x -> -x on both sides of a transform turns the signs of its first row and column, the corner's twice.
        sign = batch.K.new_ones(4, 4)
        sign[0, 1:] = sign[1:, 0] = -1
        signs = torch.where(which[:, None, None, None], sign, torch.ones_like(sign))
        return batch._replace(
            images=mirrored(batch.images),
            altered=None if batch.altered is None else mirrored(batch.altered),
            K=K,
            aTc=batch.aTc * signs,
            kTc=batch.kTc * signs,
            uv=uv,
            seen_uv=seen_uv,
        )
