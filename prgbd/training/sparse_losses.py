"""Sparse loss terms of the method: what SLAM's keypoints say about the depth of keyframes (paper, section 3.3).

A batch of points is padded: ``uv`` is (B, N, 2) in pixels of the depth map, ``mask`` (B, N) bool tells the real ones.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

REDUCTIONS = ("mean", "sum")


class Patches(NamedTuple):
    """Depth around keypoints.

    Attributes:
        pixels: (B, N, P, 2) positions, P = patch * patch, row by row.
        depth: (B, N, P) depth there.
        inside: (B, N, P) bool, whether the position lies within the image.
    """

    pixels: Tensor
    depth: Tensor
    inside: Tensor


def sample_patches(depth: Tensor, uv: Tensor, patch: int) -> Patches:
    """Read the depth of the ``patch`` x ``patch`` pixel grid centred on each keypoint.

    Keypoints lie between pixels (SLAM works at another image size), so depth is interpolated at the keypoint and at
    whole-pixel offsets from it. It is the *inverse* depth that is interpolated bilinearly: that is exact on planes, and
    at an edge it does not invent depth far behind the front.

    Args:
        depth: (B, 1, H, W), positive.
        uv: (B, N, 2) keypoints, pixels of this depth map with integers at pixel centres.
        patch: Odd side length; 1 for the keypoint alone.

    Returns:
        The patches; differentiable in ``depth``.
    """
    height, width = depth.shape[-2:]
    steps = torch.arange(patch, device=uv.device, dtype=uv.dtype) - patch // 2
    dv, du = torch.meshgrid(steps, steps, indexing="ij")
    pixels = uv[:, :, None] + torch.stack([du.reshape(-1), dv.reshape(-1)], dim=1)
    size = uv.new_tensor([width - 1, height - 1])
    grid = (2 * pixels / size - 1).to(depth.dtype)
    inverse = F.grid_sample(1 / depth, grid, mode="bilinear", padding_mode="border", align_corners=True)
    inside = ((pixels >= 0) & (pixels <= size)).all(dim=-1)
    return Patches(pixels, 1 / inverse[:, 0], inside)


def transferred_depth(patches: Patches, K: Tensor, bTa: Tensor) -> Tensor:
    """Depth of the patch points as seen from another camera: the third coordinate of ``bTa (d K^-1 [p, 1])``.

    Args:
        patches: Patches in camera a.
        K: (B, 3, 3) intrinsics of camera a, pixels.
        bTa: (B, 4, 4) transform from camera a to camera b.

    Returns:
        (B, N, P); negative for points behind camera b.
    """
    focal = torch.stack([K[:, 0, 0], K[:, 1, 1]], dim=1)[:, None, None]
    xy = (patches.pixels - K[:, None, None, :2, 2]) / focal
    row = bTa[:, 2, :, None, None]
    rotated = row[:, 0] * xy[..., 0] + row[:, 1] * xy[..., 1] + row[:, 2]
    return patches.depth * rotated + row[:, 3]


def depth_transfer(
    a: Patches, b: Patches, K: Tensor, bTa: Tensor, aTb: Tensor, mask: Tensor, reduction: str = "mean"
) -> Tensor:
    """Symmetric depth transfer between two keyframes (paper eq. for T_{c<->k1}).

    A point i that both keyframes see sits at keypoint p_a and p_b. Each pixel p_a + o of its patch in a is
    back-projected with the predicted depth of a, moved to b, and its depth there is compared with the predicted depth
    of b at the *corresponding offset* p_b + o; and the other way round::

        |d_{a->b}(p_a + o) - d_b(p_b + o)| + |d_{b->a}(p_b + o) - d_a(p_a + o)|

    This is the reading of "every pixel of the 5x5 patch around each keypoint" that needs no second search for
    correspondences; it takes the patch to look alike in both views, which its few pixels make harmless, and it is exact
    for o = 0. Gradients reach both depth maps. Offsets outside of either image are left out.

    The paper sums over points and patch pixels, so that the weight of an image grows with its number of keypoints.
    ``mean`` divides by that number, which makes one weight mean the same for every image, sequence and patch size;
    ``sum`` is the literal form.

    Args:
        a: Patches in the first keyframe.
        b: Patches in the second keyframe, same points in the same order.
        K: (B, 3, 3) intrinsics of both, pixels.
        bTa: (B, 4, 4) transform from a to b.
        aTb: (B, 4, 4) transform from b to a.
        mask: (B, N) bool, real points.
        reduction: ``mean`` or ``sum`` over the points and patch pixels of one image pair.

    Returns:
        Scalar in the unit of the depth: mean over the batch, where a pair without points counts 0.
    """
    error = (transferred_depth(a, K, bTa) - b.depth).abs() + (transferred_depth(b, K, aTb) - a.depth).abs()
    used = mask[:, :, None] & a.inside & b.inside
    return _reduce(error, used, reduction)


def depth_consistency(depth: Tensor, uv: Tensor, slam_depth: Tensor, mask: Tensor) -> Tensor:
    """Depth consistency: mean absolute difference between predicted depth and SLAM's (paper eq. for D_c).

    Args:
        depth: (B, 1, H, W) predicted depth of the current keyframe.
        uv: (B, N, 2) keypoints in it, pixels of the depth map.
        slam_depth: (B, N) depth of SLAM's points in the current camera.
        mask: (B, N) bool, real points.

    Returns:
        Scalar in the unit of the depth: mean over the points of an image, then over the batch; an image without points
        counts 0.
    """
    predicted = sample_patches(depth, uv, 1)
    error = (predicted.depth[..., 0] - slam_depth).abs()[..., None]
    return _reduce(error, (mask & predicted.inside[..., 0])[..., None], "mean")


def _reduce(error: Tensor, used: Tensor, reduction: str) -> Tensor:
    """Reduce (B, N, P) within each image over what is used, then average over the batch."""
    # torch.where, not a product: padding may hold anything, and 0 * nan would spoil the sum.
    total = torch.where(used, error, torch.zeros_like(error)).sum(dim=(1, 2))
    if reduction == "mean":
        total = total / used.sum(dim=(1, 2)).clamp(min=1)
    return total.mean()
