"""How a ``SigmaHead`` learns: the likelihood of log-depth errors at SLAM's points, and one factor from held-out ones.

The photometric likelihood of D3VO and of Klodt and Vedaldi (ECCV 2018) tells how far grey levels may be off; what the
depth of a pixel may be off by does not follow from it. Points of SLAM have a depth of their own to compare with.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from prgbd.core.sigma_head import SigmaHead

ONE_SIGMA, TWO_SIGMA = math.erf(1 / math.sqrt(2)), math.erf(2 / math.sqrt(2))
"""Shares of a normal error within one and two standard deviations."""
_ITERATIONS = 200
_RIDGE = 1e-2
_FACTORS = (0.1, 10.0)
_LEAST_SPREAD = 1e-3  # of a feature, to be told from a constant


def fit_sigma(head: SigmaHead, features: Tensor, errors: NDArray[np.floating[Any]]) -> None:
    """Let a head take the greatest likelihood of Laplacian errors; there is one maximum, and it is found.

    With ``s = log sigma`` linear in the features, ``s + sqrt(2) |error| exp(-s)`` is convex in the weights. Laplace's
    tails keep a few wild points from deciding. A ridge on the weights of standardised features decides what is left.

    Args:
        head: Takes over the weights.
        features: (N, C) of ``SigmaHead.sampled``.
        errors: (N,) absolute errors of log depth after the scale of each image is taken out.
    """
    x, size = features.double().cpu(), torch.from_numpy(np.asarray(errors, np.float64))
    mean, spread = x.mean(0), x.std(0).clamp(min=_LEAST_SPREAD)
    x = (x - mean) / spread
    start = math.log(max(float(size.mean()) * math.sqrt(2), 1e-3))  # the best constant
    parameters = torch.cat([x.new_zeros(x.shape[1]), x.new_tensor([start])]).requires_grad_()
    optimizer = torch.optim.LBFGS([parameters], max_iter=_ITERATIONS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        weight, bias = parameters[:-1], parameters[-1]
        level = x @ weight + bias
        value = (level + math.sqrt(2) * size * torch.exp(-level)).mean() + _RIDGE * weight.square().sum()
        value.backward()
        return value

    with torch.enable_grad():
        optimizer.step(loss)
    weight = parameters.detach()[:-1] / spread
    head.assign(weight.float(), float(parameters.detach()[-1] - weight @ mean))


def shares_within(errors: NDArray[np.floating[Any]], sigma: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Return the shares of errors within one and two standard deviations."""
    ratio = np.abs(errors) / sigma
    return float(np.mean(ratio < 1)), float(np.mean(ratio < 2))


def calibration_factor(errors: NDArray[np.floating[Any]], sigma: NDArray[np.floating[Any]]) -> float:
    """Return the factor on deviations that brings the shares within one and two of them nearest to a normal error's.

    Errors of networks have heavier tails than normal ones, so not both are met at once: the larger of the two misses is
    made as small as it can be.

    Args:
        errors: (N,) errors of log depth.
        sigma: (N,) their predicted standard deviations.
    """
    ratio = np.sort(np.abs(errors) / sigma)
    factors = np.geomspace(*_FACTORS, 400)
    one, two = (np.searchsorted(ratio, times * factors) / len(ratio) for times in (1, 2))
    misses = np.maximum(np.abs(one - ONE_SIGMA), np.abs(two - TWO_SIGMA))
    return float(factors[np.argmin(misses)])
