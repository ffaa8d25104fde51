"""``example/dark``: an augmentation that lets the network see darker images."""

from __future__ import annotations

import torch
from torch import Tensor

from prgbd import Augmentation, RefinementBatch


class Dark(Augmentation):
    """Darkens all images of some samples; the loss terms compare them as they were.

    Args:
        probability: Share of the samples.
        factor: On the colours, between 0 and 1.
    """

    def __init__(self, probability: float = 0.5, factor: float = 0.6) -> None:
        super().__init__(probability)
        self.factor = factor

    def augment(self, batch: RefinementBatch, which: Tensor, generator: torch.Generator) -> RefinementBatch:
        """See ``Augmentation.augment``."""
        dark = torch.where(which[:, None, None, None, None], self.factor * batch.inputs, batch.inputs)
        return batch._replace(altered=dark)
