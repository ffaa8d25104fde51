"""The pose network of Monodepth2: two images to the motion between them."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from prgbd.plugins.depth.monodepth2.encoder import CHANNELS, ResnetEncoder

OUTPUT_SCALE = 0.01
"""Keeps the first motions of a fresh network small."""


class PoseDecoder(nn.Module):
    """Four convolutions on the coarsest feature of an image pair, averaged over the image."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.ModuleList(
            [
                nn.Conv2d(CHANNELS[-1], 256, 1),
                nn.Conv2d(256, 256, 3, 1, 1),
                nn.Conv2d(256, 256, 3, 1, 1),
                nn.Conv2d(256, 12, 1),
            ]
        )

    def forward(self, feature: Tensor) -> tuple[Tensor, Tensor]:
        """Compute axis-angle and translation from the (B, 512, h, w) feature.

        Returns:
            Two tensors (B, 2, 1, 3), float32; by the published convention only ``[:, 0]`` is used.
        """
        x = feature
        for layer in self.net[:3]:
            x = F.relu(layer(x))
        x = self.net[3](x).float().mean(dim=(2, 3))
        x = OUTPUT_SCALE * x.view(-1, 2, 1, 6)
        return x[..., :3], x[..., 3:]


class PoseNetwork(nn.Module):
    """Pose encoder and decoder, called with two images in temporal order."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = ResnetEncoder(images=2)
        self.decoder = PoseDecoder()

    def parameters_of_motion(self, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
        """Return axis-angle (radians) and translation of ``secondTfirst``, each (B, 2, 1, 3), see ``PoseDecoder``."""
        return self.decoder(self.encoder(torch.cat([first, second], dim=1))[-1])

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Estimate the motion between two images.

        Args:
            first: (B, 3, H, W) RGB in [0, 1], the earlier image.
            second: (B, 3, H, W), the later one.

        Returns:
            (B, 4, 4) float32 ``secondTfirst``: maps points of the first camera to the second, translation up to the
            scale of the depth network.
        """
        axisangle, translation = self.parameters_of_motion(first, second)
        return rigid_transform(axisangle[:, 0, 0], translation[:, 0, 0])


def rigid_transform(axisangle: Tensor, translation: Tensor, invert: bool = False) -> Tensor:
    """Make the transform ``x -> R x + t`` of an axis-angle vector and a translation, or its inverse.

    Args:
        axisangle: (B, 3) rotation axis times angle, radians.
        translation: (B, 3).
        invert: Return the inverse; that is how the earlier of two neighbours is treated in Monodepth2.

    Returns:
        (B, 4, 4).
    """
    angle = torch.linalg.vector_norm(axisangle, dim=1, keepdim=True)
    x, y, z = (axisangle / (angle + 1e-7)).unbind(dim=1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).view(-1, 3, 3)
    sin, cos = torch.sin(angle)[..., None], torch.cos(angle)[..., None]
    R = torch.eye(3, device=x.device, dtype=x.dtype) + sin * cross + (1 - cos) * (cross @ cross)
    t = translation[..., None]
    if invert:
        R = R.transpose(1, 2)
        t = -R @ t
    bottom = R.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(R), 1, 4)
    return torch.cat([torch.cat([R, t], dim=2), bottom], dim=1)
