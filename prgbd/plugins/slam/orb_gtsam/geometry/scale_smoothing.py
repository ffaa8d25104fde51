"""What a depth network says of a map's scale, split into drift of the map and wander of the network."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Standard deviations and correlation lengths (keyframes) of a network's wander that are tried, the standard deviation
# that is likely before anything is known, and the factor (log) by which it may be otherwise.
_SIGMAS = (0.02, 0.035, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3)
_LENGTHS = (3.0, 10.0, 30.0)
_LIKELY, _OTHERWISE = 0.1, 0.7
# What is tried besides where a network may choose the scale of every image anew.
_ARBITRARY_SIGMAS, _ARBITRARY_LENGTHS = (0.5, 1.0), (0.3,)
# Standard deviation of the scale of a single keyframe's depth, and of the unit of the whole.
_WHITE, _UNIT = 0.03, 2.0
# Share of the odds below which a wander makes no difference.
_NEGLIGIBLE = 1e-4
# Standard deviation (log) of a drift that geometry leaves quite open.
_OPEN = 5.0


@dataclass(frozen=True)
class ScaleSplit:
    """Drift and wander.

    Attributes:
        drift: (K,) logarithm of the scale by which the map is too small around every keyframe, in the network's units.
        sigma: Standard deviation of the network's wander, the (geometric) mean of those that were tried by their odds.
        length: Its correlation length, keyframes, the same.
    """

    drift: FloatArray
    sigma: float
    length: float


def split_scale(
    log_ratio: FloatArray, covariance: FloatArray, at: FloatArray | None = None, *, arbitrary: bool = False
) -> ScaleSplit:
    """Split ``log_ratio = unit + drift + wander + noise``, all of them Gaussian, by what each can be.

    The drift has the covariance that geometry leaves it. The wander is stationary, so that it averages out over a
    drive. Its standard deviation and correlation length are not known: what each of several would give is averaged by
    how likely it makes the ratios.

    Args:
        log_ratio: (K,) logarithm of the network's depth over the map's at keyframes, NaN where that is not known.
        covariance: (K, K) of the drift, symmetric and finite.
        at: (K,) numbers of the keyframes; 0, 1, 2 and so on if left out.
        arbitrary: Whether the network may choose the scale of every image anew.

    Returns:
        The split. The network's unit is part of the drift: a map that is multiplied by ``exp(drift)`` has that unit.
    """
    at = np.arange(len(log_ratio), dtype=np.float64) if at is None else at
    covariance = _bounded(covariance)
    known = np.flatnonzero(np.isfinite(log_ratio))
    if len(known) == 0:
        return ScaleSplit(np.zeros(len(log_ratio)), _LIKELY, _LENGTHS[-1])
    unit = float(np.median(log_ratio[known]))
    observed = log_ratio[known] - unit
    apart = np.abs(at[known, None] - at[known])
    fixed = covariance[np.ix_(known, known)] + _WHITE**2 * np.eye(len(known)) + _UNIT**2
    models = [
        (sigma, length)
        for sigma in _SIGMAS + (_ARBITRARY_SIGMAS if arbitrary else ())
        for length in _LENGTHS + (_ARBITRARY_LENGTHS if arbitrary else ())
    ]
    wanders = [sigma**2 * np.exp(-apart / length) for sigma, length in models]
    log_odds = [
        _likelihood(fixed + wander, observed) - _surprise(sigma)
        for wander, (sigma, _) in zip(wanders, models, strict=True)
    ]
    odds = np.exp(np.array(log_odds) - max(log_odds))
    share = odds / odds.sum()
    solved = sum(
        share[i] * np.linalg.solve(fixed + wanders[i], observed) for i in np.flatnonzero(share > _NEGLIGIBLE).tolist()
    )
    drift = unit + (covariance[:, known] + _UNIT**2) @ solved
    sigma, length = np.exp(share @ np.log(models)).tolist()
    return ScaleSplit(drift, sigma, length)


def _bounded(covariance: FloatArray) -> FloatArray:
    """Return the nearest covariance whose variances are none below 0, nor so large that the ratios drown in them.

    A camera that stands or only turns leaves the scale open by any factor, and rounding makes such matrices indefinite.
    """
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.clip(values, 0.0, _OPEN**2 * len(values))) @ vectors.T)


def _likelihood(covariance: FloatArray, observed: FloatArray) -> float:
    """Logarithm, up to a constant."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, observed)
    return float(-0.5 * white @ white - np.log(np.diag(root)).sum())


def _surprise(sigma: float) -> float:
    return float(0.5 * (np.log(sigma / _LIKELY) / _OTHERWISE) ** 2)
