"""How two loops compare by what SLAM made of their networks, without any label."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from prgbd.core.criterion import Evidence, Verdict

LOST_SHARE = 0.01
"""A loop that tracks fewer frames than the best one by more than this share of them is worse, whatever else it did."""
LEAST = 1e-3
"""Both errors are finer than this only by chance: smaller values count as this one."""


def compare(before: Mapping[str, Evidence], now: Mapping[str, Evidence], min_improvement: float = 0.0) -> Verdict:
    """Compare two loops by their evidence.

    The index is the geometric mean of two ratios, both free of scale: the photometric error of frames that the network
    did not learn from, under the poses that SLAM found with its depth (``p``), and the disagreement of its depth with
    points triangulated from SLAM's poses and pixels alone (``d``)::

        index = exp(mean over recordings of (ln(p_now / p_before) + ln(d_now / d_before)) / 2)

    A loop is better if ``index < 1 - min_improvement`` and SLAM still tracks the frames that it did.

    Args:
        before: Evidence of the best loop so far, by recording.
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


def _common_means(before: Mapping[str, float], now: Mapping[str, float]) -> tuple[float | None, float | None]:
    """Means over the frames that both loops have."""
    common = [frame for frame in now if frame in before]
    if not common:
        return None, None
    return _mean(before[f] for f in common), _mean(now[f] for f in common)


def _mean(values: Iterable[float]) -> float:
    values = list(values)
    return math.fsum(values) / len(values)
