"""``SelfDoubting``: what a network that predicts no uncertainty lets one guess of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from prgbd.core.depth import DepthEstimator, load_matching, read_state_dict
from prgbd.core.depth_wrapper import DepthWrapper
from prgbd.core.sigma_head import SigmaHead
from prgbd.core.tensor_files import write_tensors
from prgbd.core.types import DepthPrediction

_MEASURED: dict[bool, tuple[list[float], float]] = {
    True: ([0.40, 0.19, 0.16], -1.33),
    False: ([0.45, 0.18], -1.80),
}
"""Weights, and the bias, with and without the mirror image: of the logarithm of depth over the image's median, of its
square, and of the logarithm of the disagreement. As SLAM's points on four synthetic streets taught them."""


class SelfDoubting(DepthWrapper):
    """Tells for networks that do not how wrong each pixel may be, by what is there anyway, in evaluation mode.

    The deviation follows from how far a pixel is in comparison with its image, and from how much the depths of the
    image and of its mirror image disagree there, which takes a second forward pass. How they are weighed was measured
    with the demo weights; a refinement learns it anew from SLAM's points and stores it beside the network's weights.

    Args:
        estimator: The estimator to wrap.
        mirror: Whether to look at the mirror image; else only the distance tells.
        learnt: ``self_doubt.pth`` that a refinement left in the folder of its weights; null for the measured ones.
    """

    FILE = "self_doubt.pth"

    def __init__(self, estimator: DepthEstimator, mirror: bool = True, learnt: Path | str | None = None) -> None:
        super().__init__(estimator)
        del self.__dict__["save_weights"]  # this one has something of its own to store
        self.mirror = mirror
        self.head = SigmaHead([3 if mirror else 2])
        weight, bias = _MEASURED[mirror]
        self.head.assign(torch.tensor(weight), bias)
        if learnt is not None:
            load_matching(self.head, read_state_dict(Path(learnt)), Path(learnt))

    def forward(self, images: Tensor) -> DepthPrediction:
        """See ``DepthEstimator.forward``."""
        if self.training:
            return super().forward(images)
        prediction, maps = self._with_features(images)
        return replace(prediction, sigma=self.head([maps]))

    def sigma_head(self) -> SigmaHead:
        """See ``DepthEstimator.sigma_head``."""
        return self.head

    def sigma_features(self, images: Tensor) -> list[Tensor]:
        """See ``DepthEstimator.sigma_features``."""
        return [self._with_features(images)[1]]

    def _with_features(self, images: Tensor) -> tuple[DepthPrediction, Tensor]:
        """Return the prediction, and the logarithms (B, 2 or 3, H, W) that the deviation follows from."""
        count = len(images)
        both = super().forward(torch.cat([images, images.flip(3)]) if self.mirror else images)
        straight = DepthPrediction(
            tuple(depth[:count] for depth in both.depths),
            None if both.disparities is None else tuple(disparity[:count] for disparity in both.disparities),
        )
        level = both.depth.detach().float().log()
        distance = level[:count] - level[:count].flatten(1).median(1).values[:, None, None, None]
        maps = [distance, distance.square()]
        if self.mirror:
            apart = (level[:count] - level[count:].flip(3)).abs()
            size = 2 * (apart.shape[3] // 26) + 1  # a thirteenth of the width: what disagrees errs around it as well
            apart = F.avg_pool2d(apart, size, 1, size // 2, count_include_pad=False)
            maps.append((apart + 0.02).log())
        return straight, torch.cat(maps, dim=1)

    def save_weights(self, folder: Path, **options: Any) -> None:
        """Write the network's weights, and beside them what was learnt about its error."""
        self.estimator.save_weights(folder, **options)
        write_tensors(self.head.state_dict(), Path(folder) / self.FILE)

    def load_weights(self, folder: Path) -> None:
        """Read the network's weights, and what was learnt about its error if that is there."""
        self.estimator.load_weights(folder)
        path = Path(folder) / self.FILE
        if path.is_file():
            load_matching(self.head, read_state_dict(path), path)

    def extra_repr(self) -> str:
        """What sets it apart from another one; what was learnt is among the weights."""
        return f"mirror={self.mirror}"
