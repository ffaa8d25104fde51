"""``depth_consistency`` (D): the depth of the keyframe should be that of SLAM's points."""

from __future__ import annotations

from torch import Tensor

from prgbd.core.loss import LossInputs, LossTerm
from prgbd.core.option_ranges import NotNegative
from prgbd.functional.sparse_losses import Residual, depth_consistency


class DepthConsistency(LossTerm):
    """The method's depth consistency, see ``prgbd.functional.sparse_losses.depth_consistency``.

    Logarithms have no unit. With ``residual=absolute`` it is in the network's own unit of depth: a network that was
    pre-trained without scale has a median depth near 1, and the term is about as large as the photometric one; for a
    metric network it is tens of times larger, so give it a weight of a few hundredths there.

    Args:
        weight: Gamma of the method.
        residual: ``log`` or ``absolute`` (the paper), how depths are compared; see ``sparse_losses.difference``.
    """

    def __init__(self, weight: NotNegative = 1.0, residual: Residual = "log") -> None:
        super().__init__(weight)
        self.residual = residual

    def forward(self, inputs: LossInputs) -> Tensor:
        """See ``LossTerm.forward``."""
        depth = inputs.current.depth
        points = inputs.batch.at_size(*depth.shape[-2:])
        return depth_consistency(depth, points.seen_uv, points.seen_depth, points.seen_mask, residual=self.residual)
