"""``held_out``: the refinement's own loss on keyframes that it did not train on decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from prgbd.core.criterion import Criterion, Evidence, Verdict
from prgbd.plugins.criterion.comparison import compare


class HeldOut(Criterion):
    """The held-out loss must fall; what SLAM makes of the network is recorded and decides nothing."""

    def objection(self, before: float, after: float, min_improvement: float) -> str:
        """See ``Criterion.objection``."""
        if before - after > min_improvement * abs(before):
            return ""
        if after > before:
            return (
                f"No improvement: the held-out loss rose from {before:.5f} to {after:.5f}, so the old weights are kept."
            )
        drop = 100 * (before - after) / max(abs(before), 1e-12)
        return (
            f"No improvement: the held-out loss fell from {before:.5f} to {after:.5f}, by {drop:.2f} % where more than "
            f"{100 * min_improvement:g} % is asked for, so the old weights are kept."
        )

    def judge(self, best: Mapping[str, Evidence], now: Mapping[str, Evidence], min_improvement: float) -> Verdict:
        """See ``Criterion.judge``."""
        return replace(compare(best, now, min_improvement), decides=False)
