"""``smoothness`` (S): depth should change where the image does, and little elsewhere."""

from __future__ import annotations

from torch import Tensor

from prgbd.core.loss import LossInputs, LossTerm
from prgbd.core.option_ranges import NotNegative
from prgbd.functional.losses import smoothness_loss


class Smoothness(LossTerm):
    """Monodepth2's edge-aware smoothness, see ``smoothness_loss``.

    Args:
        weight: Beta of the method.
    """

    def __init__(self, weight: NotNegative = 0.001) -> None:
        super().__init__(weight)

    def forward(self, inputs: LossInputs) -> Tensor:
        """See ``LossTerm.forward``."""
        return smoothness_loss(inputs.current, inputs.target)
