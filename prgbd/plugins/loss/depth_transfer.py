"""``depth_transfer`` (T): the depth of three keyframes should agree around the points that all of them see."""

from __future__ import annotations

from typing import Annotated, ClassVar

from torch import Tensor

from prgbd.core.errors import ConfigError
from prgbd.core.loss import LossInputs, LossTerm
from prgbd.core.option_ranges import NotNegative, Range
from prgbd.core.refinement_batch import View
from prgbd.functional.sparse_losses import Matching, Reduction, Residual, depth_transfer
from prgbd.functional.warping import invert_rigid


class DepthTransfer(LossTerm):
    """The method's symmetric depth transfer ``T_{c,k1} + T_{c,k2} + T_{k1,k2}``, see ``sparse_losses.depth_transfer``.

    It is in the network's own unit of depth where ``residual`` is ``absolute``, as ``depth_consistency`` is.

    Args:
        weight: Mu of the method (the paper: 1, which held back what the other terms gained).
        patch: Odd side of the patch around a keypoint that is compared, pixels of the network's depth.
        matching: ``projected`` or ``offset``, which pixels of two patches are compared.
        reduction: ``mean`` or ``sum`` over points and patch pixels. ``average`` is the mean over the three pairs of
            keyframes and both directions as well, so that the term weighs as much as depth consistency and not six
            times as much.
        residual: ``log`` or ``absolute`` (the paper), how depths are compared; see ``sparse_losses.difference``.
        anchored: Move patches whose middle has SLAM's depth instead of the predicted one.

    Raises:
        ConfigError: If ``patch`` is even.
    """

    views: ClassVar[tuple[View, ...]] = (View.CURRENT, View.KEYFRAME_1, View.KEYFRAME_2)
    exact_gradient: ClassVar[bool] = False  # where a patch falls in the other image is taken as measured

    def __init__(
        self,
        weight: NotNegative = 0.1,
        patch: Annotated[int, Range(1, 101)] = 5,
        matching: Matching = "projected",
        reduction: Reduction = "mean",
        residual: Residual = "log",
        anchored: bool = False,
    ) -> None:
        super().__init__(weight)
        if patch % 2 == 0:
            raise ConfigError(f"loss.depth_transfer.patch is {patch}; the side of a patch must be an odd number.")
        self.patch, self.matching, self.reduction = patch, matching, reduction
        self.residual, self.anchored = residual, anchored

    def forward(self, inputs: LossInputs) -> Tensor:
        """See ``LossTerm.forward``."""
        depths = [inputs.depth(view) for view in self.views]
        points = inputs.batch.at_size(*depths[0].shape[-2:])
        vTc = [inputs.vTc(view) for view in self.views]
        total = depths[0].new_zeros(())
        for a, b in ((0, 1), (0, 2), (1, 2)):
            total = total + depth_transfer(
                (depths[a], depths[b]),
                (points.uv[:, a], points.uv[:, b]),
                points.K,
                vTc[b] @ invert_rigid(vTc[a]),
                points.mask,
                patch=self.patch,
                matching=self.matching,
                reduction=self.reduction,
                residual=self.residual,
                anchors=(points.depth[:, a], points.depth[:, b]) if self.anchored else None,
            )
        return total / 3 if self.reduction == "average" else total
