"""``photometric`` (P): the adjacent frames, warped by depth and SLAM's poses, should look like the keyframe."""

from __future__ import annotations

from torch import Tensor

from prgbd.core.loss import LossInputs, LossTerm
from prgbd.core.option_ranges import NotNegative
from prgbd.core.refinement_batch import View
from prgbd.functional.losses import photometric_loss


class Photometric(LossTerm):
    """Monodepth2's photometric error, see ``photometric_loss``.

    Args:
        weight: Alpha of the method.
        automask: Leave out what looks the same without motion.
    """

    def __init__(self, weight: NotNegative = 1.0, automask: bool = True) -> None:
        super().__init__(weight)
        self.automask = automask

    def forward(self, inputs: LossInputs) -> Tensor:
        """See ``LossTerm.forward``."""
        batch, adjacent = inputs.batch, (View.BEFORE, View.AFTER)
        return photometric_loss(
            inputs.current,
            inputs.target,
            [batch.images[:, view] for view in adjacent],
            batch.K,
            [inputs.vTc(view) for view in adjacent],
            self.automask,
            inputs.generator,
        )
