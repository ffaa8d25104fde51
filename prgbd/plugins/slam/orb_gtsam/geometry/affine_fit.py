"""A robust fit of a scale and a shift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Points of one image err together: however many there are, they tell no more than so many independent ones.
_INDEPENDENT = 30.0
# Steps with Huber's weights, whose only minimum is found from anywhere, and then with Tukey's, which drop outliers.
_HUBER_STEPS, _TUKEY_STEPS = 15, 10
_HUBER, _TUKEY = 1.345, 4.685
# Standard deviation of a normal distribution per median absolute deviation, and the least one, of errors of size 1.
_NORMAL, _LEAST_SPREAD = 1.4826, 0.1


@dataclass(frozen=True)
class Affine:
    """``y = scale * x + shift``.

    Attributes:
        scale: Factor.
        shift: Summand, in the unit of y.
    """

    scale: float
    shift: float

    def __call__(self, x: FloatArray) -> FloatArray:
        """Map values."""
        return self.scale * x + self.shift


def fit_affine(
    x: FloatArray, y: FloatArray, sigma: FloatArray, prior: Affine | None = None, wander: Affine | None = None
) -> Affine:
    """Fit ``y = scale * x + shift`` by iteratively reweighted least squares (Huber's weights, then Tukey's).

    Args:
        x: (N,) values, at least two of them different.
        y: (N,) values.
        sigma: (N,) standard deviations of y up to a common factor, which is estimated.
        prior: What scale and shift are near; None if nothing is known.
        wander: Their standard deviations around the prior.
    """
    design = np.stack([x, np.ones_like(x)], axis=1) / sigma[:, None]
    target = y / sigma
    information, vector = np.zeros((2, 2)), np.zeros(2)
    if prior is not None and wander is not None:
        information = np.diag([wander.scale**-2.0, wander.shift**-2.0])
        vector = information @ (prior.scale, prior.shift)
    share = min(1.0, _INDEPENDENT / len(x))
    weight = np.ones(len(x))
    for step in range(_HUBER_STEPS + _TUKEY_STEPS):
        weighted = design * (share * weight)[:, None]
        found = np.linalg.lstsq(weighted.T @ design + information, weighted.T @ target + vector, rcond=None)[0]
        residual = target - design @ found
        spread = max(_LEAST_SPREAD, _NORMAL * float(np.median(np.abs(residual))))
        relative = np.abs(residual) / spread
        robust = (
            np.minimum(1.0, _HUBER / np.maximum(relative, _HUBER))
            if step < _HUBER_STEPS
            else np.maximum(0.0, 1.0 - (relative / _TUKEY) ** 2) ** 2
        )
        weight = robust / spread**2
    return Affine(float(found[0]), float(found[1]))
