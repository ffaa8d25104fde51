"""``SigmaHead``: how wrong a network's depth may be, as a log-linear function of the features that it has anyway."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

SMALLEST, LARGEST = 0.01, 3.0
START = 0.15
"""Of a head that has learnt nothing: networks that know their scene err by 10 to 20 per cent."""


class SigmaHead(nn.Module):
    """Predicts the standard deviation of log depth from feature maps of a network.

    Its logarithm is a bias and a 1x1 convolution of every map, brought to the finest size. That is little enough for
    the points of a short SLAM run to teach it, its likelihood has one maximum (see ``prgbd.training.sigma_fit``), and
    a factor of calibration is a step of the bias. No gradient passes to the features, so depth does not depend on it,
    and it is fitted, not trained: its parameters ask for no gradient.

    Args:
        channels: Of the maps, finest first.
        start: Standard deviation everywhere until something is learnt.
    """

    def __init__(self, channels: Sequence[int], start: float = START) -> None:
        super().__init__()
        self.channels = tuple(channels)
        self.start = start
        self.weight = nn.Parameter(torch.zeros(sum(self.channels)), requires_grad=False)
        self.bias = nn.Parameter(torch.tensor(math.log(start)), requires_grad=False)

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Return standard deviations, (B, 1, H, W) float32 within ``SMALLEST`` and ``LARGEST``.

        Args:
            features: (B, C_s, H_s, W_s), finest first; the first one gives the size.
        """
        size = features[0].shape[-2:]
        total = self.bias.float()
        with torch.autocast(features[0].device.type, enabled=False):
            for weight, maps in zip(self.weight.split(self.channels), features, strict=True):
                level = F.conv2d(maps.detach().float(), weight[None, :, None, None])
                if level.shape[-2:] != size:
                    level = F.interpolate(level, size=size, mode="bilinear", align_corners=False)
                total = total + level
        return total.clamp(math.log(SMALLEST), math.log(LARGEST)).exp()

    def sampled(self, features: Sequence[Tensor], uv: Tensor) -> Tensor:
        """Return the features at pixels of the finest map, (B, N, C) float32; the head is linear in them.

        Args:
            features: As in ``forward``.
            uv: (B, N, 2), integers at pixel centres.
        """
        height, width = features[0].shape[-2:]
        grid = (2 * (uv + 0.5) / uv.new_tensor([width, height]) - 1)[:, :, None]
        sampled = [
            F.grid_sample(maps.detach().float(), grid, padding_mode="border", align_corners=False) for maps in features
        ]
        return torch.cat(sampled, dim=1)[..., 0].transpose(1, 2)

    def at(self, sampled: Tensor) -> Tensor:
        """Return the standard deviations at sampled features, (..., C) to (...,)."""
        level = sampled.float() @ self.weight.to(sampled.device) + self.bias.to(sampled.device)
        return level.clamp(math.log(SMALLEST), math.log(LARGEST)).exp()

    @torch.no_grad()
    def assign(self, weight: Tensor, bias: float) -> None:
        """Take over fitted weights, (C,), and bias."""
        self.weight.copy_(weight)
        self.bias.fill_(bias)

    @torch.no_grad()
    def scale(self, factor: float) -> None:
        """Multiply all standard deviations by a factor."""
        self.bias.add_(math.log(factor))

    def reset(self) -> None:
        """Forget everything."""
        self.assign(torch.zeros_like(self.weight), math.log(self.start))
