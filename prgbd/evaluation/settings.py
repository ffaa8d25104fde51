"""``EvaluationSettings``: everything that can be chosen about the comparison with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Count, NotNegative, Positive
from prgbd.core.options import check_types

OUTDOORS = 30.0  # metres; a cap from here on gets the caps and bins of a street


@dataclass(frozen=True)
class EvaluationSettings:
    """Options of the evaluation, where there is ground truth.

    Attributes:
        depth_images: At most this many evenly spaced images per sequence; null for all.
        depth_cap: Metres beyond which truth is ignored and to which predictions are clamped.
        depth_caps: Further caps for the curves of the report, metres, each evaluated by the full protocol; auto: the
            paper's 30, 40, ... 80 m up to ``depth_cap``, or 2, 4, ... 10 m where that is indoors (below 30 m).
        depth_bins: Limits of the depth bins of the report, metres, ascending; auto: by ``depth_cap``, finer indoors.
        depth_crop: The part of the image that counts: none (all), garg or eigen.
        depth_test: Other images for the depth figures of every loop, as options of ``data=`` that differ, such as
            {split: test_files.txt}; SLAM does not run on them. null: data.test_sequences, or without any, all
            recordings.
        median_scaling: Scale each prediction by the ratio of medians; false for networks that predict metres.
        alignment: Of trajectories with the truth: sim3, se3 or none.

    Raises:
        ConfigError: If a value cannot work.
    """

    depth_images: Count | None = 100
    depth_cap: Positive = 80.0
    depth_caps: tuple[Positive, ...] | Literal["auto"] | None = "auto"
    depth_bins: tuple[NotNegative, ...] | Literal["auto"] | None = "auto"
    depth_crop: Literal["none", "garg", "eigen"] = "none"
    depth_test: dict[str, Any] | None = None
    median_scaling: bool = True
    alignment: Literal["sim3", "se3", "none"] = "sim3"

    def __post_init__(self) -> None:
        check_types(self, "evaluation")
        bins = _given(self.depth_bins)
        if bins and (len(bins) < 2 or any(b <= a for a, b in pairwise(bins))):
            raise ConfigError(
                f"evaluation.depth_bins is {list(bins)}; give at least two ascending depths in metres, or []."
            )

    @property
    def chosen_caps(self) -> tuple[float, ...]:
        """The further caps, metres."""
        given = _given(self.depth_caps)
        if given is not None:
            return tuple(given)
        candidates = range(30, 81, 10) if self.depth_cap >= OUTDOORS else range(2, 11, 2)
        return tuple(float(cap) for cap in candidates if cap <= self.depth_cap)

    @property
    def chosen_bins(self) -> tuple[float, ...]:
        """The limits of the depth bins up to ``depth_cap``, metres."""
        given = _given(self.depth_bins)
        if given is not None:
            return tuple(given)
        limits = (0, 5, 10, 15, 20, 30, 40, 60, 80) if self.depth_cap >= OUTDOORS else range(11)
        return (*(float(limit) for limit in limits if limit < self.depth_cap), self.depth_cap)


def _given(depths: Sequence[float] | str | None) -> Sequence[float] | None:
    """Return a list of depths, None for auto."""
    return None if isinstance(depths, str) else depths
