"""Statistics of batch normalisation, measured anew."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

BATCH_NORMALISATION = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d, nn.SyncBatchNorm)


def measure_batch_statistics(network: nn.Module, batches: Iterable[Tensor]) -> int:
    """Replace the running statistics of batch normalisation by their means over batches of images.

    While a network trains, each running mean and variance follows the batches with a momentum of 0.1: after a few dozen
    steps it is an average of the last ten or so, taken while the weights still moved. The weights themselves learn to
    fit the statistics of their batch, so it is the evaluation that gets worse. Averages over many images with the final
    weights have neither fault.

    Everything else of the network stays, its modes included; a network without such layers is left alone.

    Args:
        network: Is called with every batch.
        batches: Images, (B, 3, H, W) float32 on the network's device; each should be a mixture like those of training.

    Returns:
        How many layers were measured.
    """
    layers = [
        module for module in network.modules() if isinstance(module, BATCH_NORMALISATION) and module.track_running_stats
    ]
    if not layers:
        return 0
    modes = {module: module.training for module in network.modules()}
    momenta = [layer.momentum for layer in layers]
    try:
        network.eval()
        for layer in layers:
            layer.train()
            layer.reset_running_stats()
            layer.momentum = None  # PyTorch's way to say: the mean over all batches
        with torch.no_grad():
            for batch in batches:
                network(batch)
    finally:
        for layer, momentum in zip(layers, momenta, strict=True):
            layer.momentum = momentum
        for module, mode in modes.items():
            module.training = mode
    return len(layers)
