"""The helpers of depth networks."""

from __future__ import annotations

import torch

from prgbd.core.depth import weights_fingerprint


def test_fingerprint_sees_every_weight_its_name_and_its_type() -> None:
    network = torch.nn.Sequential(torch.nn.Conv2d(3, 2, 3), torch.nn.BatchNorm2d(2))
    before = weights_fingerprint(network)
    assert weights_fingerprint(network) == before
    assert weights_fingerprint(torch.nn.ModuleList(network)) == before
    assert weights_fingerprint(torch.nn.Sequential(torch.nn.Identity(), *network)) != before
    assert weights_fingerprint(network.bfloat16()) != before
    network = network.float()
    half = weights_fingerprint(network)
    with torch.no_grad():
        network[0].weight[0, 2, 2, 2] += 1e-6
    assert weights_fingerprint(network) != half
    network[1].running_mean[1] += 1
    assert weights_fingerprint(network) not in (before, half)
