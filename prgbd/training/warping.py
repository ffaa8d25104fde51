"""Differentiable geometry: from depth and relative pose to an image seen from another place.

Everything is per sample: each image of a batch has its own intrinsics and its own pose, so one batch may mix
sequences. ``sTt`` maps points of the target camera to the source camera.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

NEAREST = 1e-6
"""Depth below which a point counts as behind the camera; also keeps the division of ``project`` finite."""


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


def backproject(depth: Tensor, K: Tensor) -> Tensor:
    """Lift every pixel of a depth map to camera coordinates.

    Args:
        depth: (B, 1, H, W), z along the optical axis.
        K: (B, 3, 3) intrinsics of the depth map's own size, pixels.

    Returns:
        (B, 3, H*W) points in the unit of the depth, row by row.
    """
    batch, _, height, width = depth.shape
    grid = pixel_grid(height, width, device=depth.device, dtype=depth.dtype)
    rays = inverse_intrinsics(K) @ grid
    return rays * depth.view(batch, 1, height * width)


def transform(T: Tensor, points: Tensor) -> Tensor:
    """Apply rigid transforms (B, 4, 4) to points (B, 3, N)."""
    return torch.baddbmm(T[:, :3, 3:], T[:, :3, :3], points)


def project(points: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
    """Project camera coordinates to pixels.

    Args:
        points: (B, 3, N).
        K: (B, 3, 3) intrinsics, pixels.

    Returns:
        Pixels (B, 2, N) and depth (B, 1, N). Points behind the camera land far outside of the image, without gradient
        through their depth.
    """
    homogeneous = K @ points
    depth = homogeneous[:, 2:]
    return homogeneous[:, :2] / depth.clamp(min=NEAREST), depth


def normalised(pixels: Tensor, height: int, width: int) -> Tensor:
    """Scale pixels (B, 2, N) to [-1, 1] between the centres of the outermost pixels (``align_corners=True``)."""
    size = pixels.new_tensor([width - 1, height - 1]).view(1, 2, 1)
    return 2 * pixels / size - 1


def warp(source: Tensor, depth: Tensor, K: Tensor, sTt: Tensor) -> tuple[Tensor, Tensor]:
    """Synthesise the target view from a source image (Monodepth2: back-project, transform, project, sample).

    Coordinates are normalised between the outermost pixel *centres*, so the bilinear sampling uses
    ``align_corners=True``; samples outside of the source take its border.

    Args:
        source: (B, C, H, W) source image.
        depth: (B, 1, H, W) depth of the *target* view.
        K: (B, 3, 3) intrinsics of both views, pixels.
        sTt: (B, 4, 4) transform from target camera to source camera, translation in the unit of the depth.

    Returns:
        The warped image (B, C, H, W), and where it was really seen, (B, 1, H, W) bool.
    """
    batch, _, height, width = depth.shape
    pixels, z = project(transform(sTt, backproject(depth, K)), K)
    grid = normalised(pixels, source.shape[-2], source.shape[-1])
    valid = ((grid.detach().abs() <= 1).all(dim=1, keepdim=True) & (z.detach() > NEAREST)).view(batch, 1, height, width)
    grid = grid.view(batch, 2, height, width).permute(0, 2, 3, 1)
    return F.grid_sample(source, grid, mode="bilinear", padding_mode="border", align_corners=True), valid


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
