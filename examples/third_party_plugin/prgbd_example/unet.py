"""``example/unet``: a small U-Net that predicts depth, and the pose network of its self-supervised pre-training."""

from __future__ import annotations

import itertools
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from prgbd import DepthEstimator, DepthPrediction
from prgbd.core.errors import ConfigError

LEVELS = 4
SCALES = 3


def block(channels_in: int, channels: int, stride: int = 1) -> nn.Sequential:
    """Return two 3x3 convolutions with ELU; the first one may halve the size."""
    return nn.Sequential(
        nn.Conv2d(channels_in, channels, 3, stride, 1, padding_mode="reflect"),
        nn.ELU(inplace=True),
        nn.Conv2d(channels, channels, 3, 1, 1, padding_mode="reflect"),
        nn.ELU(inplace=True),
    )


class PoseNetwork(nn.Module):
    """Predicts the motion between two images; needed for ``task=pretrain`` alone.

    Args:
        channels: Channels after the first convolution.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        widths = [6, channels, 2 * channels, 4 * channels, 8 * channels]
        layers: list[nn.Module] = []
        for below, width in itertools.pairwise(widths):
            layers += [nn.Conv2d(below, width, 3, 2, 1), nn.ReLU(inplace=True)]
        self.layers = nn.Sequential(*layers, nn.Conv2d(widths[-1], 6, 1))

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Return ``secondTfirst``, (B, 4, 4), for two (B, 3, H, W) images in temporal order."""
        # Small motions at the start keep the first warps inside the image (Monodepth2 scales by 0.01 as well).
        twist = 0.01 * self.layers(torch.cat([first, second], 1) - 0.5).mean((2, 3)).float()
        x, y, z = twist[:, :3].unbind(1)
        zero = torch.zeros_like(x)
        rows = (torch.stack([zero, -z, y, twist[:, 3]], 1), torch.stack([z, zero, -x, twist[:, 4]], 1),
                torch.stack([-y, x, zero, twist[:, 5]], 1), torch.stack([zero] * 4, 1))  # fmt: skip
        return torch.matrix_exp(torch.stack(rows, 1))


class UNet(DepthEstimator):
    """A U-Net (Ronneberger et al., MICCAI 2015) with a disparity head at its three finest levels.

    Args:
        weights: A folder that ``save_weights`` wrote, or None for a fresh network.
        height: Input height, a multiple of 16, pixels.
        width: Input width, likewise.
        channels: Channels of the finest level; they double with each coarser one.
        min_depth: Nearest depth that the network can express.
        max_depth: Farthest depth.
        seed: Seed of a fresh network.

    Raises:
        ConfigError: If a size or the depth range cannot work.
        WeightsError: If the weights are missing or belong to another network.
    """

    metric = False  # learnt from monocular video, depth has no known scale

    def __init__(
        self,
        weights: str | Path | None = None,
        height: int = 128,
        width: int = 192,
        channels: int = 16,
        min_depth: float = 0.5,
        max_depth: float = 80.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        for name, side in (("height", height), ("width", width)):
            if side < 32 or side % 2**LEVELS:
                raise ConfigError(f"depth.{name}={side} must be a multiple of {2**LEVELS}, and at least 32.")
        if not 0 < min_depth < max_depth:
            raise ConfigError(f"depth.min_depth={min_depth:g} must lie between 0 and depth.max_depth={max_depth:g}.")
        self.input_size = (height, width)
        self.depth_range = (float(min_depth), float(max_depth))
        widths = [channels * 2**level for level in range(LEVELS + 1)]
        with torch.random.fork_rng(devices=[]):  # the same seed gives the same network, whatever was drawn before
            torch.manual_seed(seed)
            self.first = block(3, widths[0])
            self.down = nn.ModuleList(block(a, b, 2) for a, b in itertools.pairwise(widths))
            self.up = nn.ModuleList(block(a + b, a) for a, b in itertools.pairwise(widths))
            self.heads = nn.ModuleList(nn.Conv2d(width, 1, 3, 1, 1) for width in widths[:SCALES])
            self.pose = PoseNetwork(channels)
        for head in self.heads:
            nn.init.constant_(head.bias, -3.0)  # a fresh network starts far away, not at its nearest depth
        if weights is not None:
            self.load_weights(Path(weights))

    def forward(self, images: Tensor) -> DepthPrediction:
        """Predict depth and disparity at three scales for (B, 3, H, W) RGB in [0, 1]."""
        features = [self.first((images - 0.45) / 0.225)]
        for down in self.down:
            features.append(down(features[-1]))
        x, disparities = features.pop(), []
        for level in reversed(range(LEVELS)):
            skip = features.pop()
            x = self.up[level](torch.cat([skip, F.interpolate(x, size=skip.shape[2:])], 1))
            if level < SCALES:
                disparities.insert(0, torch.sigmoid(self.heads[level](x).float()))
        nearest, farthest = self.depth_range
        depths = tuple(1 / (1 / farthest + (1 / nearest - 1 / farthest) * disparity) for disparity in disparities)
        return DepthPrediction(depths, tuple(disparities))

    def pose_network(self) -> nn.Module:
        """See ``DepthEstimator.pose_network``."""
        return self.pose
