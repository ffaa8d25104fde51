"""A small made-up refinement batch whose depth is known, on which loss terms and augmentations can be tried."""

from __future__ import annotations

import torch
from torch import Tensor

from prgbd.core.refinement_batch import RefinementBatch, View

HEIGHT, WIDTH, FOCAL = 24, 32, 28.0
NORMAL, DISTANCE = (0.25, -0.15, 1.0), 4.0  # the wall n x = d, in the camera of c
STEPS = {View.BEFORE: -0.05, View.AFTER: 0.05, View.KEYFRAME_1: -0.15, View.KEYFRAME_2: 0.2}


def refinement_scene(
    samples: int = 2, points: int = 14, dtype: torch.dtype = torch.float32
) -> tuple[RefinementBatch, Tensor]:
    """Make cameras that slide along a smoothly coloured, tilted wall, with exact points.

    Args:
        samples: Samples in the batch; each one looks at another part of the wall.
        points: Points per sample that SLAM has seen.
        dtype: Of everything but the masks.

    Returns:
        The batch, and the true depth of every view, (5, B, 1, H, W).
    """
    generator = torch.Generator().manual_seed(0)
    # Off the middle, so that an augmentation that forgets the principal point is found out.
    K = torch.tensor([[FOCAL, 0, 0.55 * WIDTH], [0, FOCAL, 0.45 * HEIGHT], [0, 0, 1]], dtype=dtype)
    motions = {view: _motion(view, dtype) for view in View}
    offsets = torch.arange(samples, dtype=dtype)
    images, depths = zip(*(_rendered(K, motions[view], offsets) for view in View), strict=True)

    inside = 0.3 + 0.4 * torch.rand((samples, points, 2), generator=generator, dtype=dtype)
    uv = inside * torch.tensor([WIDTH - 1, HEIGHT - 1], dtype=dtype)
    rays = _rays(K, uv)
    xyz = rays * (DISTANCE / (rays @ torch.tensor(NORMAL, dtype=dtype)))[..., None]
    seen = [_projected(K, motions[view], xyz) for view in (View.CURRENT, View.KEYFRAME_1, View.KEYFRAME_2)]
    mask = torch.ones((samples, points), dtype=torch.bool)
    return RefinementBatch(
        images=torch.stack(images, 1),
        K=K.expand(samples, 3, 3),
        aTc=torch.stack([motions[View.BEFORE], motions[View.AFTER]]).expand(samples, 2, 4, 4),
        kTc=torch.stack([motions[View.KEYFRAME_1], motions[View.KEYFRAME_2]]).expand(samples, 2, 4, 4),
        uv=torch.stack([pixels for pixels, _ in seen], 1),
        depth=torch.stack([depth for _, depth in seen], 1),
        mask=mask,
        seen_uv=seen[0][0],
        seen_depth=seen[0][1],
        seen_mask=mask,
    ), torch.stack(depths)


def points_in(batch: RefinementBatch, view: View) -> tuple[Tensor, Tensor]:
    """Where the points of c lie in a view by its motion: pixels (B, N, 2) and depth (B, N)."""
    xyz = _rays(batch.K[:, None], batch.uv[:, 0]) * batch.depth[:, 0, :, None]
    vTc = batch.aTc[:, view - View.BEFORE] if view < View.KEYFRAME_1 else batch.kTc[:, view - View.KEYFRAME_1]
    return _projected(batch.K[:, None], vTc[:, None], xyz)


def colours_at(images: Tensor, uv: Tensor) -> Tensor:
    """Read images (B, 3, H, W) at pixels (B, N, 2), bilinearly: (B, 3, N)."""
    size = uv.new_tensor([images.shape[-1] - 1, images.shape[-2] - 1])
    grid = (2 * uv / size - 1)[:, None]
    return torch.nn.functional.grid_sample(images, grid, padding_mode="border", align_corners=True)[:, :, 0]


def _motion(view: View, dtype: torch.dtype) -> Tensor:
    step = STEPS.get(view, 0.0)
    angle = torch.tensor(0.1 * step, dtype=dtype)
    vTc = torch.eye(4, dtype=dtype)
    vTc[0, 0] = vTc[2, 2] = torch.cos(angle)
    vTc[0, 2], vTc[2, 0] = torch.sin(angle), -torch.sin(angle)
    vTc[:3, 3] = torch.tensor([-step, 0.1 * step, 0.2 * step], dtype=dtype)
    return vTc


def _rays(K: Tensor, uv: Tensor) -> Tensor:
    xy = (uv - K[..., :2, 2]) / torch.stack([K[..., 0, 0], K[..., 1, 1]], -1)
    return torch.cat([xy, torch.ones_like(xy[..., :1])], -1)


def _projected(K: Tensor, vTc: Tensor, xyz: Tensor) -> tuple[Tensor, Tensor]:
    there = (vTc[..., :3, :3] @ xyz[..., None])[..., 0] + vTc[..., :3, 3]
    focal = torch.stack([K[..., 0, 0], K[..., 1, 1]], -1)
    return there[..., :2] / there[..., 2:] * focal + K[..., :2, 2], there[..., 2]


def _rendered(K: Tensor, vTc: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Return the images (B, 3, H, W) of a view, and its depth, (B, 1, H, W)."""
    v, u = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    rays = _rays(K, torch.stack([u, v], -1).to(K.dtype))
    rotation, translation = vTc[:3, :3], vTc[:3, 3]
    normal = rotation @ torch.tensor(NORMAL, dtype=K.dtype)
    depth = (DISTANCE + normal @ translation) / (rays @ normal)
    on_wall = (rays * depth[..., None] - translation) @ rotation  # in the camera of c
    x, y = on_wall[..., 0] + offsets[:, None, None], on_wall[..., 1].expand(len(offsets), -1, -1)
    colours = [0.5 + 0.2 * torch.sin(2 * x + c) + 0.2 * torch.cos(3 * y - 2 * c) for c in range(3)]
    return torch.stack(colours, 1), depth.expand(len(offsets), 1, -1, -1)
