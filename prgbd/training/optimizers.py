"""The optimiser of pre-training and refinement."""

from __future__ import annotations

from collections.abc import Iterable

import lightning
import torch
from torch import nn

_FUSED_DEVICES = ("cpu", "cuda")


def adam(
    module: lightning.LightningModule, parameters: Iterable[nn.Parameter], learning_rate: float
) -> torch.optim.Adam:
    """Make Adam over the parameters that are trained, in one fused kernel where that works.

    The fused kernel computes the same up to rounding and saves several passes over all parameters in every step.

    Args:
        module: Whose trainer says whether gradients are clipped.
        parameters: Those without gradients are left out.
        learning_rate: At the start.
    """
    trained = [p for p in parameters if p.requires_grad]
    # Lightning takes a fused optimiser for one that unscales gradients itself, and refuses to clip for it.
    clips = module._trainer is not None and bool(module._trainer.gradient_clip_val)
    fused = not clips and all(p.device.type in _FUSED_DEVICES and p.is_floating_point() for p in trained)
    return torch.optim.Adam(trained, lr=learning_rate, fused=fused)
