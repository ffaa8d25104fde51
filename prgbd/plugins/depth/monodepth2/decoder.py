"""The depth decoder of Monodepth2: features to disparity at four scales."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from prgbd.plugins.depth.monodepth2.encoder import CHANNELS as ENCODER_CHANNELS

CHANNELS = (16, 32, 64, 128, 256)
SCALES = 4


class Conv3x3(nn.Module):
    """A 3x3 convolution with a reflected border."""

    def __init__(self, channels_in: int, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels_in, channels, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Apply to (B, C, H, W); the size stays."""
        # Autocast would pad in float32 on the CPU: two conversions of the whole map for no digit gained.
        with torch.autocast(x.device.type, enabled=False):
            padded = F.pad(x, (1, 1, 1, 1), mode="reflect")
        return self.conv(padded)


class ConvBlock(nn.Module):
    """``Conv3x3`` followed by ELU."""

    def __init__(self, channels_in: int, channels: int) -> None:
        super().__init__()
        self.conv = Conv3x3(channels_in, channels)

    def forward(self, x: Tensor) -> Tensor:
        """Apply to (B, C, H, W); the size stays."""
        return F.elu(self.conv(x), inplace=True)


class Head(Conv3x3):
    """``Conv3x3`` to one channel.

    Args:
        channels: Of the input.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Apply to (B, C, H, W); the size stays, one channel remains."""
        if torch.is_grad_enabled() or not x.is_contiguous(memory_format=torch.channels_last):
            return super().forward(x)
        # With the channels innermost one output channel takes as long as eight. Three of them, the columns of the
        # kernel, need a third of the taps each; to shift and add them is cheap.
        padded = F.pad(x, (1, 1, 1, 1), mode="reflect")
        columns = F.conv2d(padded, self.conv.weight.permute(3, 1, 2, 0))
        left, middle, right = columns.split(1, dim=1)
        assert self.conv.bias is not None
        return left[..., :-2] + middle[..., 1:-1] + right[..., 2:] + self.conv.bias


class DepthDecoder(nn.Module):
    """Five steps of convolution, upsampling, skip connection and convolution, with a disparity head at the last four.

    The modules form one list in the order of the published files: two blocks per step from coarse to fine, then the
    heads from fine to coarse.
    """

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for step in range(4, -1, -1):
            below = ENCODER_CHANNELS[-1] if step == 4 else CHANNELS[step + 1]
            skip = ENCODER_CHANNELS[step - 1] if step > 0 else 0
            layers += [ConvBlock(below, CHANNELS[step]), ConvBlock(CHANNELS[step] + skip, CHANNELS[step])]
        layers += [Head(CHANNELS[scale]) for scale in range(SCALES)]
        self.decoder = nn.ModuleList(layers)

    def forward(self, features: list[Tensor], scales: int = SCALES) -> tuple[Tensor, ...]:
        """Decode the features of ``ResnetEncoder``; see ``decoded`` for the arguments and what comes first there."""
        return self.decoded(features, scales)[0]

    def decoded(self, features: list[Tensor], scales: int = SCALES) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """Decode the features of ``ResnetEncoder``.

        Args:
            features: Its output.
            scales: How many disparities to compute, counted from the finest.

        Returns:
            Disparities in (0, 1), float32, finest first: (B, 1, H / 2**s, W / 2**s) for s = 0, 1, ...; and the maps of
            ``CHANNELS[s]`` channels that they, and the coarser ones, are computed from.
        """
        x = features[-1]
        disparities: list[Tensor] = []
        maps: list[Tensor] = []
        for step in range(4, -1, -1):
            x = self.decoder[2 * (4 - step)](x)
            x = F.interpolate(x, scale_factor=2.0, mode="nearest")
            if step > 0:
                x = torch.cat([x, features[step - 1]], dim=1)
            x = self.decoder[2 * (4 - step) + 1](x)
            if step < SCALES:
                maps.append(x)
            if step < scales:
                # A disparity in half precision has too few digits far away, whatever the layers below compute in.
                with torch.autocast(x.device.type, enabled=False):
                    disparities.append(torch.sigmoid(self.decoder[10 + step](x.float())))
        return tuple(reversed(disparities)), tuple(reversed(maps))


def disparity_to_depth(disparity: Tensor, min_depth: float, max_depth: float) -> Tensor:
    """Turn a sigmoid output in (0, 1) into depth in (min_depth, max_depth), linear in inverse depth (Monodepth2)."""
    nearest, farthest = 1 / min_depth, 1 / max_depth
    return 1 / (farthest + (nearest - farthest) * disparity)
