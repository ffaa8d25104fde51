"""ResNet-18 as a pyramid of features, with the state-dict names of the published weight files.

Follows He et al., "Deep Residual Learning for Image Recognition", and the encoder of Monodepth2 (Godard et al.,
"Digging into Self-Supervised Monocular Depth Estimation").
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

CHANNELS = (64, 64, 128, 256, 512)
"""Channels of the five features, from half the image size down to 1/32."""

IMAGE_MEAN, IMAGE_STD = 0.45, 0.225


class BasicBlock(nn.Module):
    """Two 3x3 convolutions with a shortcut around them.

    Args:
        channels_in: Channels of the input.
        channels: Channels of the output.
        stride: Of the first convolution; the shortcut is a 1x1 convolution where the shape changes.
    """

    def __init__(self, channels_in: int, channels: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels_in, channels, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(channels)
        self.downsample: nn.Module | None = None
        if stride != 1 or channels_in != channels:
            self.downsample = nn.Sequential(
                nn.Conv2d(channels_in, channels, 1, stride, bias=False), nn.BatchNorm2d(channels)
            )

    def forward(self, x: Tensor) -> Tensor:
        """Apply the block to (B, C, H, W)."""
        shortcut = x if self.downsample is None else self.downsample(x)
        x = F.relu(self.bn1(self.conv1(x)), inplace=True)
        return F.relu(self.bn2(self.conv2(x)) + shortcut, inplace=True)


class ResNet18(nn.Module):
    """The layers of ResNet-18, named as in torchvision, so that its ImageNet weights fit.

    Args:
        images: Number of RGB images that are stacked along the channels.
    """

    def __init__(self, images: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3 * images, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.layer1 = nn.Sequential(BasicBlock(64, 64, 1), BasicBlock(64, 64, 1))
        self.layer2 = nn.Sequential(BasicBlock(64, 128, 2), BasicBlock(128, 128, 1))
        self.layer3 = nn.Sequential(BasicBlock(128, 256, 2), BasicBlock(256, 256, 1))
        self.layer4 = nn.Sequential(BasicBlock(256, 512, 2), BasicBlock(512, 512, 1))
        # The classifier is never used. It is kept because the published files have it and their programs insist on it.
        self.fc = nn.Linear(512, 1000).requires_grad_(False)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")


class ResnetEncoder(nn.Module):
    """The encoder of Monodepth2: images to five features.

    Args:
        images: Number of RGB images that are stacked along the channels: 1 for depth, 2 for pose.
    """

    def __init__(self, images: int = 1) -> None:
        super().__init__()
        self.encoder = ResNet18(images)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Compute the features.

        Args:
            images: (B, 3 * images, H, W) RGB in [0, 1]; the depth decoder needs multiples of 32, the pose decoder none.

        Returns:
            Five features of ``CHANNELS`` channels at 1/2, 1/4, 1/8, 1/16 and 1/32 of the size, rounded up.
        """
        net = self.encoder
        x = F.relu(net.bn1(net.conv1((images - IMAGE_MEAN) / IMAGE_STD)))
        features = [x, net.layer1(F.max_pool2d(x, 3, 2, 1))]
        for layer in (net.layer2, net.layer3, net.layer4):
            features.append(layer(features[-1]))
        return features

    def load_imagenet(self, state: dict[str, Tensor]) -> None:
        """Start from torchvision's ResNet-18 weights; the first layer is tiled over the images and divided by them.

        Args:
            state: State dict of torchvision's ``resnet18``.

        Raises:
            RuntimeError: If the names or shapes do not fit.
        """
        state = dict(state)
        images = self.encoder.conv1.in_channels // 3
        if "conv1.weight" in state:
            state["conv1.weight"] = torch.cat([state["conv1.weight"]] * images, dim=1) / images
        self.encoder.load_state_dict(state)
