"""Ranges of options, declared with their types: ``share: Annotated[float, Range(0, 1)]``.

A plain ``float`` takes any finite number and a plain ``int`` any of 64 bits; the names below are the usual ranges.
``options`` holds every value to them, and ``option_errors`` says them in words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated


@dataclass(frozen=True)
class Range:
    """The numbers that an option takes.

    Attributes:
        least: The smallest one.
        most: The largest one.
        without: One of the two ends, if it is left out.
    """

    least: float = -math.inf
    most: float = math.inf
    without: float | None = None

    def __contains__(self, value: float) -> bool:
        """Say whether a number lies in the range; infinity and NaN lie in none."""
        return math.isfinite(value) and self.least <= value <= self.most and value != self.without

    def words(self, noun: str) -> str:
        """Say the range in words.

        Args:
            noun: What lies in it: ``a whole number``, or ``numbers``.
        """
        if math.isinf(self.most):
            if self.without is None:
                return f"{noun}, {self.least:g} or more"
            article = "a " if noun.startswith("a ") else ""
            positive = f"{article}positive {noun.removeprefix('a ')}"
            return positive if self.least == 0 else f"{noun} above {self.least:g}"
        end = "" if self.without is None else f", without {self.without:g}"
        return f"{noun} from {self.least:.10g} to {self.most:.10g}{end}"


Positive = Annotated[float, Range(0, without=0)]
NotNegative = Annotated[float, Range(0)]
Share = Annotated[float, Range(0, 1)]
# More than these neither fit into the 32 bits that OpenCV, COLMAP and NumPy's generators count in, nor make sense.
Count = Annotated[int, Range(1, 10**9)]
CountOrZero = Annotated[int, Range(0, 10**9)]
# Pixels along one side of an image.
LARGEST_SIDE = 16384
Side = Annotated[int, Range(1, LARGEST_SIDE)]
Seed = Annotated[int, Range(0, 2**32 - 1)]
