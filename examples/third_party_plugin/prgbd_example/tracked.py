"""``example/tracked``: a criterion that looks at nothing but the frames that SLAM tracks."""

from __future__ import annotations

from collections.abc import Mapping

from prgbd import Criterion, Evidence, Verdict


class Tracked(Criterion):
    """A loop is better if SLAM loses no more frames of any recording than with the best network so far.

    Args:
        slack: Share of the frames that may be lost on top.
    """

    def __init__(self, slack: float = 0.0) -> None:
        self.slack = slack

    def judge(self, best: Mapping[str, Evidence], now: Mapping[str, Evidence], min_improvement: float) -> Verdict:
        """See ``Criterion.judge``; the improvement that the loop asks for has no meaning here."""
        better = all(now[name]["tracked"] >= best[name]["tracked"] - self.slack for name in now)
        before, after = (sum(e["tracked"] for e in loop.values()) / len(loop) for loop in (best, now))
        return Verdict(better, figures={"tracked": (before, after)})
