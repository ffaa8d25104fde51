"""What the depth benchmark compares with: Monodepth2's prediction and training step, written straight down in float32.

Everything is done as the paper's formulas read, by PyTorch's own layers: images are decoded one by one, each scale and
each source is projected from the start, SSIM pools all of its five images every time. Nothing is imported from
prgbd.training, so that the benchmark's comparison of losses compares two programs.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator


def predicted(network: DepthEstimator, sequence: Sequence) -> Iterator[NDArray[np.float32]]:
    """Predict the depth of frame after frame: decode, resize, compute."""
    network.eval()
    with torch.no_grad():
        for index in range(len(sequence)):
            yield network(prepared(network, sequence, index)).depth[0, 0].cpu().numpy()


def prepared(network: DepthEstimator, sequence: Sequence, index: int) -> Tensor:
    """Decode a frame and resize it to (1, 3, H, W) float32 on the network's device."""
    height, width = network.input_size
    image = cv2.resize(sequence.frame(index).image, (width, height), interpolation=cv2.INTER_AREA)
    batch = torch.from_numpy(image).permute(2, 0, 1)[None].to(next(network.parameters()).device).float() / 255
    return batch.contiguous()


class PlainStep:
    """A training step on triplets; ``step`` returns the loss before it.

    Args:
        network: Depth network.
        pose: Pose network.
        learning_rate: Of Adam.
        smoothness: Weight of the smoothness term.
    """

    def __init__(self, network: DepthEstimator, pose: nn.Module, learning_rate: float, smoothness: float) -> None:
        self.network, self.pose, self.smoothness = network.train(), pose.train(), smoothness
        trained = [p for part in (network, pose) for p in part.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(trained, lr=learning_rate)

    def step(self, images: Tensor, K: Tensor, noise: torch.Generator) -> float:
        """Train on images (B, 3, 3, H, W): target, earlier, later."""
        loss = self.loss(images, K, noise)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return float(loss.detach())

    def loss(self, images: Tensor, K: Tensor, noise: torch.Generator) -> Tensor:
        """Photometric loss over four scales with automatic masking, and smoothness."""
        target, earlier, later = images.unbind(dim=1)
        prediction = self.network(target)
        motions = [torch.linalg.inv(self.pose(earlier, target)), self.pose(target, later)]
        size = target.shape[-2:]
        total = target.new_zeros(())
        for scale, disparity in enumerate(prediction.disparities):
            full = F.interpolate(disparity, size, mode="bilinear", align_corners=False)
            covisibility, far = self.network.depth_range
            depth = 1 / (1 / far + (1 / covisibility - 1 / far) * full)
            warps = [warped(s, depth, K, T) for s, T in zip((earlier, later), motions, strict=True)]
            errors = torch.cat([photometric(w, target) for w in warps], dim=1)
            still = torch.cat([photometric(s, target) for s in (earlier, later)], dim=1)
            still = still + 1e-5 * torch.randn(still.shape, generator=noise, device=still.device)
            total = total + torch.cat([errors, still], dim=1).min(dim=1).values.mean()
            small = F.interpolate(target, disparity.shape[-2:], mode="area")
            total = total + self.smoothness * smoothness(disparity, small) / 2**scale
        return total / len(prediction.disparities)


def warped(source: Tensor, depth: Tensor, K: Tensor, sTt: Tensor) -> Tensor:
    """Back-project, transform, project and sample."""
    batch, _, height, width = depth.shape
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack([u, v, torch.ones_like(u)]).float().view(1, 3, -1).to(depth.device)
    points = (torch.linalg.inv(K) @ pixels) * depth.view(batch, 1, -1)
    points = torch.cat([points, torch.ones_like(points[:, :1])], dim=1)
    projected = K @ (sTt @ points)[:, :3]
    xy = projected[:, :2] / (projected[:, 2:] + 1e-7)
    xy = xy.view(batch, 2, height, width).permute(0, 2, 3, 1)
    grid = 2 * xy / torch.tensor([width - 1, height - 1], device=depth.device) - 1
    return F.grid_sample(source, grid, padding_mode="border", align_corners=True)


def photometric(a: Tensor, b: Tensor) -> Tensor:
    """0.85 SSIM + 0.15 L1, mean over the channels."""
    a_, b_ = (F.pad(x, (1, 1, 1, 1), mode="reflect") for x in (a, b))
    mean_a, mean_b = F.avg_pool2d(a_, 3, 1), F.avg_pool2d(b_, 3, 1)
    var_a = F.avg_pool2d(a_**2, 3, 1) - mean_a**2
    var_b = F.avg_pool2d(b_**2, 3, 1) - mean_b**2
    covariance = F.avg_pool2d(a_ * b_, 3, 1) - mean_a * mean_b
    similarity = (2 * mean_a * mean_b + 0.01**2) * (2 * covariance + 0.03**2)
    similarity = similarity / ((mean_a**2 + mean_b**2 + 0.01**2) * (var_a + var_b + 0.03**2))
    structure = ((1 - similarity) / 2).clamp(0, 1).mean(dim=1, keepdim=True)
    return 0.85 * structure + 0.15 * (a - b).abs().mean(dim=1, keepdim=True)


def smoothness(disparity: Tensor, image: Tensor) -> Tensor:
    """Edge-aware first differences of the mean-normalised disparity."""
    normalised = disparity / (disparity.mean(dim=(2, 3), keepdim=True) + 1e-7)
    dx = (normalised[..., :-1] - normalised[..., 1:]).abs()
    dy = (normalised[..., :-1, :] - normalised[..., 1:, :]).abs()
    edge_x = (image[..., :-1] - image[..., 1:]).abs().mean(dim=1, keepdim=True)
    edge_y = (image[..., :-1, :] - image[..., 1:, :]).abs().mean(dim=1, keepdim=True)
    return (dx * torch.exp(-edge_x)).mean() + (dy * torch.exp(-edge_y)).mean()
