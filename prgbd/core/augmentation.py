"""The interface of what changes the samples of a training at random: ``Augmentation``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Share

if TYPE_CHECKING:
    import torch

    from prgbd.core.refinement_batch import RefinementBatch


class Augmentation(ABC):
    """Changes some samples of a training batch at random.

    A subclass implements ``augment``; its constructor takes ``probability`` besides its own options.

    Args:
        probability: Share of the samples that are changed; 0 switches the augmentation off.

    Raises:
        ConfigError: If the share is none.
    """

    probability: float = 0.5

    def __init__(self, probability: Share = 0.5) -> None:
        if not 0 <= probability <= 1:
            raise ConfigError(f"{type(self).__name__} has a probability of {probability}; it must lie between 0 and 1.")
        self.probability = probability

    def __call__(self, batch: RefinementBatch, generator: torch.Generator) -> RefinementBatch:
        """Change a share of the samples.

        Args:
            batch: Float images, on the device.
            generator: Random numbers, on the CPU.
        """
        import torch

        which = torch.rand(len(batch.images), generator=generator) < self.probability
        return self.augment(batch, which.to(batch.images.device), generator)

    @abstractmethod
    def augment(self, batch: RefinementBatch, which: torch.Tensor, generator: torch.Generator) -> RefinementBatch:
        """Return the batch with the chosen samples changed and the others as they are; the given one stays as it is.

        What the geometry follows changes ``images`` together with cameras, motions and keypoints, and ``altered`` in
        the same way where it is set. What it does not, such as colours, reads ``batch.inputs`` and sets ``altered``
        alone: the network sees it, while the loss terms compare the images as they were.

        Args:
            batch: Float images, on the device.
            which: (B,) bool, the chosen samples.
            generator: Random numbers, on the CPU.
        """
