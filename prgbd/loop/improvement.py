"""``Improvement``: what a finished self-improvement leaves in the hands of its caller."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prgbd.core.depth import DepthEstimator

_SHOWN = (("ate_rmse", "ATE", "m"), ("abs_rel", "Abs Rel", ""), ("held_out_loss", "held-out loss", ""))


@dataclass(frozen=True, repr=False)
class Improvement:
    """The result of ``prgbd.improve``.

    Attributes:
        depth: The network with the weights of the best loop.
        summary: All figures, as in ``summary.json``.
        folder: The folder of the run: trajectories, maps, weights, depth samples.
        report: The report, one HTML file.
    """

    depth: DepthEstimator
    summary: dict[str, Any]
    folder: Path
    report: Path

    @property
    def loops(self) -> list[dict[str, Any]]:
        """The figures of every loop, those that do not exist None.

        ``loop``, ``name``, ``ate_rmse`` (metres, the mean over all recordings), ``tracked`` (part of the frames),
        ``abs_rel`` and ``a1`` of the depth, and ``held_out_loss`` after the refinement that followed the loop.
        """
        return [_figures(loop) for loop in self.summary["loops"]]

    @property
    def best_loop(self) -> int:
        """The loop whose network and trajectory were kept."""
        return int(self.summary["stop"]["best_loop"])

    def __repr__(self) -> str:
        """Say in a few lines what every loop reached, and where it lies."""
        loops = self.loops
        width = max(len(loop["name"]) for loop in loops)
        lines = [f"Improvement of {self.summary['depth']} on {', '.join(self.summary['sequences'])}"]
        for loop in loops:
            shown = [f"{word} {loop[key]:.4f} {unit}".rstrip() for key, word, unit in _SHOWN if loop[key] is not None]
            best = "  (best)" if loop["loop"] == self.best_loop else ""
            lines.append(f"  loop {loop['loop']}  {loop['name']:<{width}}  {', '.join(shown)}{best}")
        if self.summary["stop"]["reason"]:
            lines.append(f"  {self.summary['stop']['reason']}")
        return "\n".join([*lines, f"  report: {self.report}"])


def _figures(loop: dict[str, Any]) -> dict[str, Any]:
    pose, depth, training = list(loop["pose"].values()), loop["depth"] or {}, loop["training"] or {}
    errors = [figures["ate_rmse"] for figures in pose if figures.get("ate_rmse") is not None]
    return {
        "loop": loop["loop"],
        "name": loop["name"],
        "ate_rmse": float(np.mean(errors)) if errors else None,
        "tracked": sum(figures["tracked_frames"] for figures in pose) / sum(figures["frames"] for figures in pose),
        "abs_rel": depth.get("abs_rel"),
        "a1": depth.get("a1"),
        "held_out_loss": training.get("held_out_after"),
    }
