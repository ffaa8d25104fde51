"""Differentiable geometry: from depth and relative pose to an image seen from another place.

Everything is per sample: each image of a batch has its own intrinsics and its own pose, so one batch may mix
sequences. ``sTt`` maps points of the target camera to the source camera.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

NEAREST = 1e-6
"""Depth below which a point counts as behind the camera; also keeps the projection finite."""

ON_BORDER = 1e-5
"""Beyond the border by this much is on it, in halves of the image's width or height."""


def pixel_grid(height: int, width: int, *, device: torch.device, dtype: torch.dtype) -> Tensor:
    """Return the homogeneous pixel centres (u, v, 1) of an image, (3, H*W), row by row."""
    v, u = torch.meshgrid(
        torch.arange(height, device=device, dtype=dtype),
        torch.arange(width, device=device, dtype=dtype),
        indexing="ij",
    )
    return torch.stack([u.reshape(-1), v.reshape(-1), torch.ones_like(u).reshape(-1)])


def inverse_intrinsics(K: Tensor) -> Tensor:
    """Invert pinhole intrinsics without a linear solve.

    Args:
        K: (B, 3, 3) with zero skew, pixels.

    Returns:
        (B, 3, 3).
    """
    fx, fy, cx, cy = K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2]
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    rows = [1 / fx, zero, -cx / fx, zero, 1 / fy, -cy / fy, zero, zero, one]
    return torch.stack(rows, dim=1).view(-1, 3, 3)


class Reprojection(NamedTuple):
    """All of a warp that does not depend on depth: target pixel p of depth d lies at ``d * rays[p] + offset``.

    The first two coordinates are divided by the third and less 1 in [-1, 1] between the centres of the outermost
    pixels of the source (``align_corners=True``); the third is the depth seen from the source.

    Attributes:
        rays: (B, 3, H*W), row by row.
        offset: (B, 3, 1).
    """

    rays: Tensor
    offset: Tensor


def reprojection(K: Tensor, sTt: Tensor, size: tuple[int, int], source_size: tuple[int, int]) -> Reprojection:
    """Prepare warps by one motion, for any number of depth maps.

    Args:
        K: (B, 3, 3) intrinsics of both views, pixels.
        sTt: (B, 4, 4) transform from target camera to source camera.
        size: (height, width) of the target.
        source_size: (height, width) of the source.
    """
    scale = K.new_tensor([2 / (source_size[1] - 1), 2 / (source_size[0] - 1), 1.0])[:, None]
    scaled = scale * K
    grid = pixel_grid(*size, device=K.device, dtype=K.dtype)
    return Reprojection(scaled @ sTt[:, :3, :3] @ inverse_intrinsics(K) @ grid, scaled @ sTt[:, :3, 3:])


class _Grid(torch.autograd.Function):
    """Where to sample, with the gradient written out: autograd would keep and walk through nine maps."""

    @staticmethod
    def forward(ctx: Any, depth: Tensor, rays: Tensor, offset: Tensor) -> Tensor:
        points = torch.addcmul(offset, rays, depth)
        z = points[:, 2:].clamp(min=NEAREST)
        grid = (points[:, :2] / z).sub_(1)
        ctx.save_for_backward(depth, rays, grid, z)
        return grid

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
        depth, rays, grid, z = ctx.saved_tensors
        by_points = torch.empty_like(rays)
        by_xy = torch.div(gradient, z, out=by_points[:, :2])
        # A point behind the camera passes no gradient through its depth.
        torch.sum((grid + 1).mul_(by_xy), dim=1, keepdim=True, out=by_points[:, 2:]).mul_(z > NEAREST).neg_()
        needs_depth, needs_rays, needs_offset = ctx.needs_input_grad
        by_depth = (by_points * rays).sum(dim=1, keepdim=True) if needs_depth else None
        by_offset = by_points.sum(dim=2, keepdim=True) if needs_offset else None
        return by_depth, by_points.mul_(depth) if needs_rays else None, by_offset


def sampling_grid(depth: Tensor, motion: Reprojection) -> Tensor:
    """Project the pixels of a target view into a source.

    Args:
        depth: (B, 1, H, W), z along the optical axis of the target.
        motion: See ``reprojection``.

    Returns:
        (B, 2, H, W): x and y in [-1, 1] between the centres of the outermost pixels of the source. Points behind its
        camera land far outside.
    """
    batch, _, height, width = depth.shape
    grid: Tensor = _Grid.apply(depth.reshape(batch, 1, height * width), *motion)
    return grid.view(batch, 2, height, width)


def resampled(source: Tensor, grid: Tensor) -> Tensor:
    """Sample a source (B, C, H, W) bilinearly at ``sampling_grid``'s (B, 2, h, w); outside is the border's colour."""
    return F.grid_sample(source, grid.permute(0, 2, 3, 1), mode="bilinear", padding_mode="border", align_corners=True)


def warp(source: Tensor, depth: Tensor, K: Tensor, sTt: Tensor) -> tuple[Tensor, Tensor]:
    """Synthesise the target view from a source image (Monodepth2: back-project, transform, project, sample).

    Args:
        source: (B, C, H, W) source image.
        depth: (B, 1, H, W) depth of the *target* view.
        K: (B, 3, 3) intrinsics of both views, pixels.
        sTt: (B, 4, 4) transform from target camera to source camera, translation in the unit of the depth.

    Returns:
        The warped image (B, C, H, W), and where it was really seen, (B, 1, H, W) bool.
    """
    batch, _, height, width = depth.shape
    motion = reprojection(K, sTt, (height, width), (source.shape[-2], source.shape[-1]))
    grid = sampling_grid(depth, motion)
    z = torch.addcmul(motion.offset[:, 2:], motion.rays[:, 2:], depth.reshape(batch, 1, -1)).view(depth.shape)
    # A point that falls on the border itself was seen, whatever side of it rounding puts it.
    valid = (grid.detach().abs() <= 1 + ON_BORDER).all(dim=1, keepdim=True) & (z.detach() > NEAREST)
    return resampled(source, grid), valid


def transformation_from_parameters(axisangle: Tensor, translation: Tensor, invert: bool = False) -> Tensor:
    """Make a rigid transform from the output of a pose network, as Monodepth2 does.

    Args:
        axisangle: (B, 3) rotation axis times angle, radians.
        translation: (B, 3).
        invert: Return the inverse transform instead.

    Returns:
        (B, 4, 4): ``x -> R x + t``, or with ``invert`` ``x -> R^T (x - t)``.
    """
    R = rotation_from_axisangle(axisangle)
    t = translation.unsqueeze(-1)
    if invert:
        R = R.transpose(1, 2)
        t = -R @ t
    bottom = R.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(R.shape[0], 1, 4)
    return torch.cat([torch.cat([R, t], dim=2), bottom], dim=1)


def rotation_from_axisangle(axisangle: Tensor) -> Tensor:
    """Rodrigues' formula: (B, 3) axis times angle in radians -> (B, 3, 3); differentiable at zero too."""
    angle = torch.linalg.vector_norm(axisangle, dim=1, keepdim=True)
    x, y, z = (axisangle / (angle + 1e-7)).unbind(dim=1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).view(-1, 3, 3)
    sin, cos = torch.sin(angle)[..., None], torch.cos(angle)[..., None]
    identity = torch.eye(3, device=axisangle.device, dtype=axisangle.dtype)
    return identity + sin * cross + (1 - cos) * (cross @ cross)


def invert_rigid(T: Tensor) -> Tensor:
    """Invert rigid transforms, (B, 4, 4), by transposition."""
    R = T[:, :3, :3].transpose(1, 2)
    bottom = T[:, 3:]
    return torch.cat([torch.cat([R, -R @ T[:, :3, 3:]], dim=2), bottom], dim=1)
