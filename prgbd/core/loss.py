"""The interface of the terms that a depth network is refined with: ``LossTerm``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import torch
from torch import Tensor, nn

from prgbd.core.errors import ContractError
from prgbd.core.option_ranges import NotNegative
from prgbd.core.refinement_batch import RefinementBatch, View
from prgbd.core.types import DepthPrediction


@dataclass(frozen=True)
class LossInputs:
    """What a loss term sees of a step.

    Attributes:
        batch: Images, cameras, motions, and SLAM's points and their depth; all float32, the images in [0, 1].
        views: The images whose depth was predicted, ascending.
        prediction: Their depth, one view after the other: maps of (len(views) * B, 1, H_s, W_s), float32.
        generator: Random numbers on the device of the batch; a step draws the same whatever came before it.
    """

    batch: RefinementBatch
    views: tuple[View, ...]
    prediction: DepthPrediction
    generator: torch.Generator | None = None

    @cached_property
    def current(self) -> DepthPrediction:
        """The depth of the keyframe c at every scale, maps of (B, 1, H_s, W_s)."""
        size = len(self.batch.images)
        disparities, sigma = self.prediction.disparities, self.prediction.sigma
        return DepthPrediction(
            tuple(depth[:size] for depth in self.prediction.depths),
            None if disparities is None else tuple(disparity[:size] for disparity in disparities),
            None if sigma is None else sigma[:size],
        )

    def depth(self, view: View = View.CURRENT) -> Tensor:
        """Return the finest depth of a view, (B, 1, H, W).

        Raises:
            ContractError: If no term that takes part declares the view.
        """
        if view not in self.views:
            raise ContractError(f"The depth of {view!r} was not predicted; name it in the term's 'views'.")
        return self._finest[self.views.index(view)]

    @cached_property
    def _finest(self) -> tuple[Tensor, ...]:
        return self.prediction.depth.chunk(len(self.views))

    @property
    def target(self) -> Tensor:
        """The image of the keyframe c, (B, 3, H, W) in [0, 1]; no augmentation altered its colours."""
        return self.batch.images[:, View.CURRENT]

    def vTc(self, view: View) -> Tensor:
        """Return the motion from the keyframe c to a view, (B, 4, 4): it maps points of c to the view's camera."""
        if view == View.CURRENT:
            motion = self.batch.kTc
            return torch.eye(4, device=motion.device, dtype=motion.dtype).expand_as(motion[:, 0])
        if view in (View.BEFORE, View.AFTER):
            return self.batch.aTc[:, view - View.BEFORE]
        return self.batch.kTc[:, view - View.KEYFRAME_1]


class LossTerm(nn.Module, ABC):
    """A term of the loss that a depth network is refined with: ``total = sum of weight * term``.

    A subclass implements ``forward``; its constructor takes ``weight`` besides its own options. It is a module so that
    tensors that it needs move to the device with everything else; its parameters, if it has any, are not trained.

    Attributes:
        views: Images whose depth the term compares. Each one beyond the keyframe c costs a pass of the network.
        exact_gradient: Whether the gradient is the derivative of the value; False where some of it is held back on
            purpose, so that ``check_loss`` does not compare it with finite differences.
        weight: Its factor in the sum; a term of weight 0 is not computed.

    Args:
        weight: See above.
    """

    views: ClassVar[tuple[View, ...]] = (View.CURRENT,)
    exact_gradient: ClassVar[bool] = True

    def __init__(self, weight: NotNegative = 1.0) -> None:
        super().__init__()
        self.weight = weight

    @abstractmethod
    def forward(self, inputs: LossInputs) -> Tensor:
        """Return the term of a batch, unweighted.

        It is called in float32 even under mixed precision, must leave the batch as it is, and must give a finite value
        for samples without points (``mask`` all False) as well.

        Returns:
            Scalar, differentiable in the predicted depth.
        """
