"""``example/edge``: a loss term that forbids steps of depth where the image has none."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from prgbd import LossInputs, LossTerm
from prgbd.core.errors import ConfigError


class Edge(LossTerm):
    """The gradient of log depth, excused where the image has a sharp edge.

    Args:
        weight: Of the term in the sum.
        sharpness: The larger, the weaker an edge of the image that excuses one of depth.

    Raises:
        ConfigError: If the sharpness is negative.
    """

    def __init__(self, weight: float = 0.1, sharpness: float = 10.0) -> None:
        super().__init__(weight)
        if sharpness < 0:
            raise ConfigError(f"loss.edge.sharpness={sharpness:g} must be 0 or positive.")
        self.sharpness = sharpness

    def forward(self, inputs: LossInputs) -> Tensor:
        """See ``LossTerm.forward``."""
        log = inputs.current.depth.log()
        image = F.adaptive_avg_pool2d(inputs.target, log.shape[-2:])
        total = log.new_zeros(())
        for dim in (2, 3):
            edge = image.diff(dim=dim).abs().mean(1, keepdim=True)
            total = total + (log.diff(dim=dim).abs() * (-self.sharpness * edge).exp()).mean()
        return total
