"""Predictions whose inverse depth lacks scale and shift, brought to SLAM's points before any term sees them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from prgbd.core.errors import ConfigError
from prgbd.core.refinement_batch import RefinementBatch, View
from prgbd.core.types import DepthPrediction
from prgbd.functional.affine_alignment import align_inverse_depth
from prgbd.functional.sparse_losses import sample_patches


def aligned(prediction: DepthPrediction, batch: RefinementBatch, views: Sequence[View]) -> DepthPrediction:
    """Align every image's inverse depth with SLAM's points in it; all scales by what the finest one needs.

    Args:
        prediction: One view after the other: maps of (len(views) * B, 1, H_s, W_s).
        batch: SLAM's points.
        views: Whose depth it is.

    Raises:
        ConfigError: If a view is no keyframe, as SLAM has points in keyframes alone.
    """
    if wrong := set(views) & {View.BEFORE, View.AFTER}:
        raise ConfigError(
            f"A loss term looks at the depth of {min(wrong).name}, but depth of the kind affine_disparity can only be "
            "aligned in keyframes; leave the term out, or take another network."
        )
    points = batch.at_size(*prediction.depth.shape[-2:])
    found = [_points(points, view) for view in views]
    count = max(mask.shape[1] for _, _, mask in found)
    uv, depth, mask = (torch.cat([_padded(part[i], count) for part in found]) for i in range(3))
    seen = sample_patches(prediction.depth, uv, 1)
    mask = mask & seen.inside[..., 0] & (depth > 0)
    fit = align_inverse_depth(1 / seen.depth[..., 0], 1 / torch.where(mask, depth, torch.ones_like(depth)), mask)
    depths = tuple(fit.depth(depth) for depth in prediction.depths)
    sigma = prediction.sigma
    if sigma is not None:  # an error of inverse depth is scaled but not shifted with it
        sigma = sigma * fit.scale[:, None, None, None] * depths[0] / prediction.depth
    return DepthPrediction(depths, prediction.disparities, sigma)


def _points(points: RefinementBatch, view: View) -> tuple[Tensor, Tensor, Tensor]:
    """Return pixels (B, N, 2) of SLAM's points in a keyframe, their depth (B, N) and which are real (B, N)."""
    if view == View.CURRENT:
        return points.seen_uv, points.seen_depth, points.seen_mask
    row = view - View.KEYFRAME_1 + 1
    return points.uv[:, row], points.depth[:, row], points.mask


def _padded(values: Tensor, count: int) -> Tensor:
    """Lengthen the second axis by zeros."""
    return torch.cat([values, values.new_zeros((len(values), count - values.shape[1], *values.shape[2:]))], dim=1)
