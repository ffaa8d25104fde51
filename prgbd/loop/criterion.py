"""Whether a loop made things better, decided without labels from what SLAM made of the refined network."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

CRITERIA = ("held_out", "slam", "both")
LOST_SHARE = 0.01
"""A loop that tracks fewer frames than the best one by more than this share of them is worse, whatever else it did."""
LEAST = 1e-3
"""Both errors are finer than this only by chance: smaller values count as this one."""


@dataclass(frozen=True)
class Verdict:
    """How a loop compares with the best one before it.

    Attributes:
        better: Whether it becomes the best one.
        index: Geometric mean over recordings and figures of value now over value before, below 1 for an improvement;
            None where nothing could be measured in both loops.
        figures: What it rests on: ``photometric``, ``disagreement`` and ``tracked``, each before and now (means over
            the recordings).
    """

    better: bool
    index: float | None
    figures: dict[str, tuple[float, float]]

    def sentence(self) -> str:
        """Say in words what the verdict rests on."""
        names = {
            "photometric": "photometric error",
            "disagreement": "disagreement with triangulated depth",
            "tracked": "frames tracked",
        }
        told = []
        for key, (before, now) in self.figures.items():
            if key == "tracked" and before == now:
                continue
            both = f"{before:.0%} -> {now:.0%}" if key == "tracked" else f"{before:.4f} -> {now:.4f}"
            told.append(f"{names[key]} {both}")
        index = "" if self.index is None else f", index {self.index:.3f}"
        return (", ".join(told) or "nothing could be measured") + index

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for the summary."""
        return {
            "better": self.better,
            "index": self.index,
            **{key: {"before": before, "now": now} for key, (before, now) in self.figures.items()},
        }


def compare(
    before: Mapping[str, Mapping[str, Any]], now: Mapping[str, Mapping[str, Any]], min_improvement: float = 0.0
) -> Verdict:
    """Compare two loops by their evidence.

    The index is the geometric mean of two ratios, both free of scale: the photometric error of frames that the network
    did not learn from, under the poses that SLAM found with its depth (``p``), and the disagreement of its depth with
    points triangulated from SLAM's poses and pixels alone (``d``)::

        index = exp(mean over recordings of (ln(p_now / p_before) + ln(d_now / d_before)) / 2)

    A loop is better if ``index < 1 - min_improvement`` and SLAM still tracks the frames that it did.

    Args:
        before: ``evidence`` of the best loop so far, by recording.
        now: The same of the loop in question.
        min_improvement: Fraction by which the index must lie below 1.
    """
    logs: list[float] = []
    seen: dict[str, list[tuple[float, float]]] = {"photometric": [], "disagreement": [], "tracked": []}
    for name, current in now.items():
        past = before[name]
        pairs = {
            "photometric": _common_means(past["photometric"], current["photometric"]),
            "disagreement": (past["disagreement"], current["disagreement"]),
        }
        for key, (old, new) in pairs.items():
            if old is not None and new is not None:
                seen[key].append((old, new))
                logs.append(math.log(max(new, LEAST) / max(old, LEAST)))
        seen["tracked"].append((past["tracked"], current["tracked"]))
    figures = {
        key: (_mean(v[0] for v in values), _mean(v[1] for v in values)) for key, values in seen.items() if values
    }
    index = math.exp(_mean(logs)) if logs else None
    lost = any(new < old - LOST_SHARE for old, new in seen["tracked"])
    return Verdict(not lost and (index is None or index < 1 - min_improvement), index, figures)


def stop_reason(before: float | None, after: float | None, min_improvement: float | None) -> str:
    """Return why the loop should stop after a refinement, "" to go on; no label is needed to decide.

    Args:
        before: Loss on held-out keyframes with the weights that SLAM ran with.
        after: The same with the refined weights.
        min_improvement: Fraction by which the loss must drop; None accepts any finite loss.
    """
    if before is None or after is None or not math.isfinite(before) or not math.isfinite(after):
        return "The held-out loss was not finite after the refinement, so the weights from before are kept."
    if min_improvement is None or before - after > min_improvement * abs(before):
        return ""
    if after > before:
        return f"No improvement: the held-out loss rose from {before:.5f} to {after:.5f}, so the old weights are kept."
    drop = 100 * (before - after) / max(abs(before), 1e-12)
    return (
        f"No improvement: the held-out loss fell from {before:.5f} to {after:.5f}, by {drop:.2f} % where more than "
        f"{100 * min_improvement:g} % is asked for, so the old weights are kept."
    )


def _common_means(before: Mapping[str, float], now: Mapping[str, float]) -> tuple[float | None, float | None]:
    """Means over the frames that both loops have."""
    common = [frame for frame in now if frame in before]
    if not common:
        return None, None
    return _mean(before[f] for f in common), _mean(now[f] for f in common)


def _mean(values: Any) -> float:
    values = list(values)
    return math.fsum(values) / len(values)
