"""The interface of what decides, without any label, whether a loop made things better: ``Criterion``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypedDict

WORDS = {
    "photometric": "photometric error",
    "disagreement": "disagreement with triangulated depth",
    "tracked": "frames tracked",
}


class Evidence(TypedDict):
    """What a SLAM run says of the network whose depth it used, without any label and free of scale.

    None stands where there is nothing to measure.
    """

    tracked: float
    """Share of the frames with a pose."""
    maps: int
    """Unconnected maps."""
    inliers: float | None
    """Mean inlier matches of a tracked frame."""
    reprojection: float | None
    """Median reprojection error, pixels."""
    disagreement: float | None
    """Mean absolute difference of log depth between network and triangulation, less the median of a keyframe."""
    scale_wander: float | None
    """Standard deviation of those medians: how the scale between network and map changes over keyframes."""
    photometric: dict[str, float]
    """Per frame, by number: photometric error of its neighbours warped by the network's depth and SLAM's poses."""


@dataclass(frozen=True)
class Verdict:
    """How a loop compares with the best one before it.

    Attributes:
        better: Whether it becomes the best one.
        index: The value that decided, below 1 for an improvement; None where nothing could be measured in both loops.
        figures: What it rests on, each before and now, for the report.
        decides: Whether the loop follows the verdict; otherwise it is only told and recorded.
    """

    better: bool
    index: float | None = None
    figures: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    decides: bool = True

    def sentence(self) -> str:
        """Say in words what the verdict rests on."""
        told = []
        for key, (before, now) in self.figures.items():
            if key == "tracked" and before == now:
                continue
            both = f"{before:.0%} -> {now:.0%}" if key == "tracked" else f"{before:.4f} -> {now:.4f}"
            told.append(f"{WORDS.get(key, key)} {both}")
        index = "" if self.index is None else f", index {self.index:.3f}"
        return (", ".join(told) or "nothing could be measured") + index

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for the summary."""
        return {
            "better": self.better,
            "index": self.index,
            **{key: {"before": before, "now": now} for key, (before, now) in self.figures.items()},
        }


class Criterion(ABC):
    """Decides without labels whether a loop made things better: whether its network is kept and the loop goes on.

    It is asked twice. After a refinement ``objection`` may spare a SLAM run that cannot help; after SLAM ran with the
    refined network, ``judge`` compares what came of it with the best loop so far.
    """

    def objection(self, before: float, after: float, min_improvement: float) -> str:
        """Say after a refinement why the loop should stop with the old weights, "" to let SLAM run with the new ones.

        Args:
            before: Loss on held-out keyframes with the weights that SLAM ran with; finite.
            after: The same with the refined weights; finite.
            min_improvement: ``task.min_improvement``, the fraction that counts as an improvement.

        Returns:
            One sentence, or "" as here.
        """
        return ""

    @abstractmethod
    def judge(self, best: Mapping[str, Evidence], now: Mapping[str, Evidence], min_improvement: float) -> Verdict:
        """Compare a loop with the best one before it.

        Args:
            best: Evidence of the best loop so far, by recording.
            now: The same of the loop in question.
            min_improvement: ``task.min_improvement``, the fraction that counts as an improvement.
        """
