"""Whether a network knows how wrong it is: calibration and sparsification of the predicted deviation of log depth.

The error is that of log depth after the median error of the image is taken out: the scale that an image shares is not
what a pixel's deviation tells.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.evaluation.depth import DEFAULT_CAP, evaluation_mask

NOMINAL = np.round(np.arange(0.05, 1.0, 0.05), 2)
"""Shares of the calibration curve."""
REMOVED = np.round(np.arange(0.0, 1.0, 0.05), 2)
"""Shares of the sparsification curve."""
_TIMES = np.array([NormalDist().inv_cdf((1 + share) / 2) for share in NOMINAL])
_FEWEST = 20
Floats = NDArray[np.floating[Any]]


class UncertaintyEvaluation:
    """Collects images one by one; nothing but sums of curves is kept.

    Calibration: which share of the errors lies within the deviations that would hold a nominal share of normal errors.
    Sparsification (Ilg et al., ECCV 2018): the mean error that is left when the pixels that are said to be worst are
    removed, beside that when the really worst ones are. The area between the two, over the area between a random order
    and the best, is 0 for a perfect order and 1 for one that says nothing.
    """

    def __init__(self) -> None:
        self._images = 0
        self._pixels = 0
        self._within = np.zeros(2)
        self._covered = np.zeros(len(NOMINAL))
        self._predicted, self._best = np.zeros(len(REMOVED)), np.zeros(len(REMOVED))

    def add_image(
        self,
        truth: NDArray[np.float32],
        depth: NDArray[np.float32],
        sigma: NDArray[np.float32],
        cap: tuple[float, float] = DEFAULT_CAP,
        crop: str = "none",
    ) -> None:
        """Take in the pixels of an image whose true depth is known, within the cap and the crop.

        Args:
            truth: (H, W) true depth in metres, 0 where unknown.
            depth: (H, W) predicted depth.
            sigma: (H, W) predicted standard deviation of its logarithm.
            cap: (nearest, farthest) metres.
            crop: ``none``, ``garg`` or ``eigen``.
        """
        known = evaluation_mask(truth, cap, crop)
        self.add(np.log(depth[known].astype(np.float64) / truth[known]), sigma[known])

    def add(self, errors: Floats, sigma: Floats) -> None:
        """Take in an image's errors of log depth, (N,), its scale among them, and their predicted deviations, (N,)."""
        if len(errors) < _FEWEST:
            return
        size = np.abs(errors - np.median(errors))
        ratio = size / sigma
        self._images += 1
        self._pixels += len(size)
        self._within += [np.count_nonzero(ratio < 1), np.count_nonzero(ratio < 2)]
        self._covered += np.searchsorted(np.sort(ratio), _TIMES)
        self._predicted += sparsification(size, np.asarray(sigma))
        self._best += sparsification(size, size)

    def result(self) -> dict[str, Any] | None:
        """Return the figures as plain numbers (keys: docs/summary-schema.md); None without an image."""
        if not self._images:
            return None
        predicted, best = self._predicted / self._images, self._best / self._images
        chance = float(best[0])
        area = float(np.sum(chance - best))
        return {
            "images": self._images,
            "pixels": self._pixels,
            "within_one": float(self._within[0] / self._pixels),
            "within_two": float(self._within[1] / self._pixels),
            "ause": float(np.sum(predicted - best) / area) if area > 0 else None,
            "mean_error": chance,
            "calibration": [
                {"nominal": float(share), "observed": float(count / self._pixels)}
                for share, count in zip(NOMINAL, self._covered, strict=True)
            ],
            "sparsification": [
                {"removed": float(share), "error": float(error), "best": float(least)}
                for share, error, least in zip(REMOVED, predicted, best, strict=True)
            ],
        }


def sparsification(errors: Floats, order: Floats) -> NDArray[np.float64]:
    """Return the mean of the errors that are left when the shares ``REMOVED`` with the highest ``order`` are gone."""
    ascending = np.cumsum(errors[np.argsort(order, kind="stable")], dtype=np.float64)
    left = np.maximum(1, np.rint((1 - REMOVED) * len(errors)).astype(int))
    return np.asarray(ascending[left - 1] / left)
