"""``slam``: what SLAM makes of the refined network decides."""

from __future__ import annotations

from collections.abc import Mapping

from prgbd.core.criterion import Criterion, Evidence, Verdict
from prgbd.plugins.criterion.comparison import compare


class Slam(Criterion):
    """The index of SLAM's evidence must fall, see ``comparison.compare``; the held-out loss decides nothing."""

    def judge(self, best: Mapping[str, Evidence], now: Mapping[str, Evidence], min_improvement: float) -> Verdict:
        """See ``Criterion.judge``."""
        return compare(best, now, min_improvement)
