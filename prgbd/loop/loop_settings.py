"""The options of the loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from prgbd.core.computing import Computing
from prgbd.core.errors import ConfigError
from prgbd.io.export import DEFAULT_FORMATS
from prgbd.loop.criterion import CRITERIA
from prgbd.loop.depth_figures import DepthProtocol
from prgbd.loop.slam_runs import MapFiles

FIRST_TEACHERS = ("pseudo_rgbd", "mono")


@dataclass(frozen=True)
class LoopSettings:
    """Options of the loop.

    Attributes:
        max_loops: Refinements of the network at most.
        min_improvement: The criterion must drop by more than this fraction, or the loop stops; None never stops it
            early and keeps the last loop, for ablations.
        criterion: What decides whether a loop helped: ``held_out`` (the loss of the refinement on held-out keyframes),
            ``slam`` (what SLAM made of the refined network, see ``prgbd.loop.criterion``) or ``both``.
        first_teacher: What the first refinement learns from: ``pseudo_rgbd``, SLAM on the network's depth as in all
            later ones (the paper), or ``mono``, SLAM on the images alone, for a network that does not know the scene.
        patience: Go on after so many loops in a row that SLAM's evidence calls no better; the best one is kept anyway.
        baseline: Fixed virtual baseline in metres; None adapts it to the network's depth.
        running_baseline: Let SLAM adapt the baseline to the frames so far, as on a live camera, instead.
        baseline_percentile: d_max of the adaptive baseline is this percentile of the predicted depth.
        batch_size: Frames per forward pass of the sensor; None chooses by device.
        computing: Precision and speed of the sensor's network.
        cache: Folder for predicted depth that several runs share; None keeps it in the run until it is used.
        depth: How depth is evaluated.
        alignment: Of trajectories with the truth: ``sim3``, ``se3`` or ``none``.
        seed: Seed of everything random.
        export: Formats of SLAM's results, see ``prgbd.io.export.save_result``.
        maps: Files of SLAM's maps; not with refinement, which changes the scale of the depth.

    Raises:
        ConfigError: If a value cannot work.
    """

    max_loops: int = 3
    min_improvement: float | None = 0.0
    criterion: str = "held_out"
    first_teacher: str = "pseudo_rgbd"
    patience: int = 0
    baseline: float | None = None
    running_baseline: bool = False
    baseline_percentile: float = 100.0
    batch_size: int | None = None
    computing: Computing = field(default_factory=Computing)
    cache: Path | None = None
    depth: DepthProtocol = field(default_factory=DepthProtocol)
    alignment: str = "sim3"
    seed: int = 0
    export: tuple[str, ...] = DEFAULT_FORMATS
    maps: MapFiles = field(default_factory=MapFiles)

    def __post_init__(self) -> None:
        if isinstance(self.max_loops, bool) or not isinstance(self.max_loops, int) or self.max_loops < 0:
            raise ConfigError(f"task.max_loops is {self.max_loops}; it must be a whole number, 0 or more.")
        if self.min_improvement is not None and not 0 <= self.min_improvement < 1:
            raise ConfigError(f"task.min_improvement is {self.min_improvement}; it must lie between 0 and 1.")
        if self.criterion not in CRITERIA:
            raise ConfigError(f"task.criterion is '{self.criterion}'; choose one of {', '.join(CRITERIA)}.")
        if self.first_teacher not in FIRST_TEACHERS:
            raise ConfigError(
                f"task.first_teacher is '{self.first_teacher}'; choose one of {', '.join(FIRST_TEACHERS)}."
            )
        if isinstance(self.patience, bool) or not isinstance(self.patience, int) or self.patience < 0:
            raise ConfigError(f"task.patience is {self.patience}; it must be a whole number, 0 or more.")
        if not 0 < self.baseline_percentile <= 100:
            raise ConfigError(
                f"sensing.baseline_percentile is {self.baseline_percentile}; it must lie between 0 and 100."
            )
        if self.max_loops and self.maps != MapFiles():
            raise ConfigError("Maps of SLAM are loaded and saved without refinement alone; add task=slam.")
