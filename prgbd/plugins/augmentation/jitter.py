"""``jitter``: colours change, the geometry does not."""

from __future__ import annotations

import torch
from torch import Tensor

from prgbd.core.augmentation import Augmentation
from prgbd.core.option_ranges import NotNegative, Share
from prgbd.core.refinement_batch import RefinementBatch
from prgbd.functional.colour import jittered


class Jitter(Augmentation):
    """Jitters brightness, contrast, saturation and hue, of all images of a sample alike (Monodepth2).

    The network sees the jittered images, the loss terms compare the ones as they were.

    Args:
        probability: Share of the samples that are jittered.
        strength: Factor on Monodepth2's ranges.

    Raises:
        ConfigError: If a value cannot work.
    """

    def __init__(self, probability: Share = 0.5, strength: NotNegative = 1.0) -> None:
        super().__init__(probability)
        self.strength = strength

    def augment(self, batch: RefinementBatch, which: Tensor, generator: torch.Generator) -> RefinementBatch:
        """See ``Augmentation.augment``."""
        return batch._replace(altered=jittered(batch.inputs, which, generator, self.strength))
