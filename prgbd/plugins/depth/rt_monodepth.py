"""RT-MonoDepth-S, a real-time depth network of 1.2 M parameters.

Feng et al., "Real-time Monocular Depth Estimation on Embedded Systems".
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from prgbd.core.depth import DepthEstimator, load_matching, read_state_dict, stored_size
from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import ConfigError, WeightsError
from prgbd.core.option_ranges import Positive, Seed, Side
from prgbd.core.tensor_files import write_tensors
from prgbd.core.types import DepthPrediction
from prgbd.io.files import atomic_path

ENCODER, DEPTH = "encoder.pth", "depth.pth"
EXTRA = ("height", "width", "use_stereo")
STAGES = (64, 64, 128, 192)
DECODER = (96, 64, 32, 16)
SCALES = 3
DEFAULT_SIZE = (192, 640)


class Encoder(nn.Module):
    """A 7x7 convolution and three stages of two 3x3 convolutions; each halves the size."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, STAGES[0], 7, 2, 3, bias=False)
        self.convs = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(below, channels, 3, 2, 1),
                nn.LeakyReLU(0.1, inplace=True),
                nn.Conv2d(channels, channels, 3, 1, 1),
                nn.LeakyReLU(0.1, inplace=True),
            )
            for below, channels in pairwise(STAGES)
        )

    def forward(self, images: Tensor) -> Tensor:
        """Map (B, 3, H, W) RGB in [0, 1] to the feature (B, 192, H / 16, W / 16)."""
        x = F.relu(self.conv1((images - 0.45) / 0.225))
        for stage in self.convs:
            x = stage(x)
        return x


class Block(nn.Module):
    """A 3x3 convolution with a reflected border, then ELU."""

    def __init__(self, channels_in: int, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels_in, channels, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Apply to (B, C, H, W); the size stays."""
        # Autocast would pad in float32 on the CPU: two conversions of the whole map for no digit gained.
        with torch.autocast(x.device.type, enabled=False):
            padded = F.pad(x, (1, 1, 1, 1), mode="reflect")
        return F.elu(self.conv(padded), inplace=True)


class Head(nn.Module):
    """A 3x3 convolution to one channel, with a border of zeros."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv3 = nn.Conv2d(channels, 1, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Compute the disparity (B, 1, H, W) in (0, 1), float32."""
        # A disparity in half precision has too few digits far away, whatever the layers below compute in.
        with torch.autocast(x.device.type, enabled=False):
            return torch.sigmoid(self.conv3(x.float()))


class Decoder(nn.Module):
    """Four steps of block, upsampling and block, without skip connections; heads at the last three."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for below, channels in zip((STAGES[-1], *DECODER), DECODER, strict=False):
            layers += [Block(below, channels), Block(channels, channels)]
        layers += [Head(channels) for channels in DECODER[: -SCALES - 1 : -1]]
        self.decoder = nn.ModuleList(layers)

    def forward(self, x: Tensor, scales: int = SCALES) -> tuple[Tensor, ...]:
        """Decode the feature to disparities at the finest ``scales``: (B, 1, H / 2**s, W / 2**s) for s = 0, 1, ..."""
        disparities: list[Tensor] = []
        for step in range(4):
            x = self.decoder[2 * step](x)
            x = self.decoder[2 * step + 1](F.interpolate(x, scale_factor=2.0, mode="nearest"))
            scale = 3 - step
            if scale < scales:
                disparities.append(self.decoder[8 + scale](x))
        return tuple(reversed(disparities))


class RTMonoDepth(DepthEstimator):
    """RT-MonoDepth-S.

    Args:
        weights: Folder with the published ``encoder.pth`` and ``depth.pth``, or None for a fresh network.
        scale: Factor that turns the network's depth into metres (5.4 for the weights that were trained with stereo);
            None leaves depth up to scale.
        height: Network input height, a multiple of 16; None takes the size in the weight files, or 192.
        width: Network input width, a multiple of 16; None takes the size in the weight files, or 640.
        min_depth: Nearest depth that the network can express, before ``scale``.
        max_depth: Farthest depth that the network can express, before ``scale``.
        seed: Seed of a fresh network.

    Raises:
        ConfigError: If a size, the scale or the depth range cannot work.
        WeightsError: If weights are missing or belong to another network.
    """

    def __init__(
        self,
        weights: str | Path | None = None,
        scale: Positive | None = None,
        height: Side | None = None,
        width: Side | None = None,
        min_depth: Positive = 0.1,
        max_depth: Positive = 100.0,
        seed: Seed = 0,
    ) -> None:
        super().__init__()
        if not 0 < min_depth < max_depth:
            raise ConfigError(f"depth.min_depth={min_depth:g} must lie between 0 and depth.max_depth={max_depth:g}.")
        self.depth_kind = DepthKind.SCALE if scale is None else DepthKind.METRIC
        self.scale = 1.0 if scale is None else float(scale)
        self.depth_range = (self.scale * min_depth, self.scale * max_depth)
        self.input_size = DEFAULT_SIZE
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.encoder = Encoder()
            self.depth = Decoder()
        if weights is not None:
            self.load_weights(Path(weights))
        self.input_size = (int(height or self.input_size[0]), int(width or self.input_size[1]))
        if min(self.input_size) < 32 or any(side % 16 for side in self.input_size):
            raise ConfigError(
                f"RT-MonoDepth's input size {self.input_size[1]}x{self.input_size[0]} must be multiples of 16 from 32 "
                "up; change depth.width and depth.height."
            )

    def forward(self, images: Tensor) -> DepthPrediction:
        """Predict depth and disparity at 3 scales, or at the finest one within ``finest_scale``.

        Args:
            images: (B, 3, H, W) RGB in [0, 1]; H and W are multiples of 16.
        """
        disparities = self.depth(self.encoder(images), 1 if self.only_finest else SCALES)
        farthest, nearest = 1 / self.depth_range[1], 1 / self.depth_range[0]
        depths = tuple(1 / (farthest + (nearest - farthest) * disparity) for disparity in disparities)
        return DepthPrediction(depths, disparities)

    def save_weights(self, folder: Path) -> None:
        """Write ``encoder.pth`` and ``depth.pth`` as the published ones into ``folder`` (made if needed)."""
        height, width = self.input_size
        extra = {"height": height, "width": width, "use_stereo": self.metric}
        for part, name, more in ((self.encoder, ENCODER, extra), (self.depth, DEPTH, {})):
            state = {key: value.detach().cpu() for key, value in part.state_dict().items()}
            with atomic_path(Path(folder) / name) as temporary:
                write_tensors({**state, **more}, temporary)

    def load_weights(self, folder: Path) -> None:
        """Read ``encoder.pth`` and ``depth.pth`` from ``folder`` (or a file in it) and take over their input size.

        Raises:
            WeightsError: If a file is missing, unreadable or made for another network.
        """
        folder = Path(folder)
        folder = folder.parent if folder.is_file() else folder
        for name in (ENCODER, DEPTH):
            if not (folder / name).is_file():
                raise WeightsError(f"There is no {folder / name}; point depth.weights to a folder that has it.")
        state: dict[str, Any] = read_state_dict(folder / ENCODER)
        extra = {name: state.pop(name) for name in EXTRA if name in state}
        load_matching(self.encoder, state, folder / ENCODER)
        load_matching(self.depth, read_state_dict(folder / DEPTH), folder / DEPTH)
        self.input_size = stored_size(extra, folder / ENCODER) or self.input_size
