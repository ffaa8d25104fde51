"""The options of the loop and of the depth sensor that it uses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from prgbd.core.computing import Computing
from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Count, CountOrZero, Range
from prgbd.core.options import check_types
from prgbd.core.registry import REGISTRY
from prgbd.evaluation.settings import EvaluationSettings
from prgbd.io.export import DEFAULT_FORMATS
from prgbd.loop.map_files import MapFiles
from prgbd.training.budget import read_budget


@dataclass(frozen=True)
class SensingSettings(Computing):
    """Options of the depth network as a depth sensor.

    Attributes:
        precision: Of the network: float32, bfloat16, float16, or auto (bfloat16 where the processor computes in it).
        channels_last: Memory layout that convolutions are faster in on most processors; changes the last digits.
        compile: Use torch.compile: a minute once, then faster; needs a C++ compiler.
        batch_size: Frames per forward pass; auto is 8 on a GPU, 1 on the CPU, and there 4 in half precision.
        baseline_percentile: d_max of the adaptive baseline is this percentile of all predicted depths; 100 is the
            largest.
        cache: A FOLDER to keep predicted depth in and share between runs; null keeps it in the run until it is used.

    Raises:
        ConfigError: If a value cannot work.
    """

    batch_size: Count | Literal["auto"] | None = "auto"
    baseline_percentile: Annotated[float, Range(0, 100, without=0)] = 100.0
    cache: Path | None = None

    def __post_init__(self) -> None:
        check_types(self, "sensing")

    @property
    def frames_at_once(self) -> int | None:
        """The batch size, None for auto."""
        return self.batch_size if isinstance(self.batch_size, int) else None


@dataclass(frozen=True)
class SelfImprovement:
    """Options of ``task=self_improve``: SLAM on the network's depth, the network refined on SLAM's output, and again.

    Attributes:
        max_loops: Refinements of the network at most (the paper: 5 on KITTI, 3 on TUM). One long one did as much as
            several short ones, each of which costs a SLAM run.
        budget: How long each refinement learns: steps (500), a time that its first steps turn into a number (10min, 1h,
            90s), or auto: ten passes over SLAM's keyframes, 30 to 300 steps. Not beside ``training.epochs``.
        min_improvement: Stop, and go back to the best loop, unless the criterion drops by more than this fraction; null
            never stops early and keeps the last loop, so that all runs of an ablation end after the same loop.
        criterion: What decides whether a loop helped, the id of a plug-in: slam (what SLAM makes of the refined
            network), held_out (the refinement's loss on held-out keyframes), both, or that of another package.
        patience: Go on after so many loops in a row that SLAM's evidence calls no better; the best one is kept anyway.
        first_teacher: What the first refinement learns from: pseudo_rgbd, SLAM on the network's depth as in all later
            ones (the paper), mono, SLAM on the images alone, or auto: for each recording mono where triangulation
            refutes the network's depth, or where SLAM tracks clearly more frames without it.
        baselines: Further rows of the tables, on the test recordings or, without any, on all: mono (slam= on the images
            alone, the paper's RGB ORB-SLAM) and posenet (the pose network that lies beside depth.weights, its motions
            chained).

    Raises:
        ConfigError: If a value cannot work.
    """

    name: ClassVar[str] = "self_improve"

    max_loops: CountOrZero = 1
    budget: Count | str = "auto"
    min_improvement: Annotated[float, Range(0, 1, without=1)] | None = 0.0
    criterion: str = "slam"
    patience: CountOrZero = 0
    first_teacher: Literal["auto", "pseudo_rgbd", "mono"] = "auto"
    baselines: tuple[Literal["mono", "posenet"], ...] = ()

    def __post_init__(self) -> None:
        check_types(self, "task")
        read_budget(self.budget)


@dataclass(frozen=True)
class LoopSettings(SelfImprovement):
    """All that the loop is told.

    Attributes:
        criterion_options: Options of the criterion, ``criterion.*``.
        baseline: Fixed virtual baseline in metres; None adapts it to the network's depth.
        running_baseline: Let SLAM adapt the baseline to the frames so far, as on a live camera, instead.
        sensing: How the network predicts depth.
        evaluation: How depth and trajectories are compared with the truth.
        seed: Seed of everything random.
        export: Formats of SLAM's results, see ``prgbd.io.export.save_result``.
        maps: Files of SLAM's maps; not with refinement, which changes the scale of the depth.

    Raises:
        ConfigError: If a value cannot work.
    """

    criterion_options: Mapping[str, Any] = field(default_factory=dict)
    baseline: float | None = None
    running_baseline: bool = False
    sensing: SensingSettings = field(default_factory=SensingSettings)
    evaluation: EvaluationSettings = field(default_factory=EvaluationSettings)
    seed: int = 0
    export: tuple[str, ...] = DEFAULT_FORMATS
    maps: MapFiles = field(default_factory=MapFiles)

    def __post_init__(self) -> None:
        super().__post_init__()
        REGISTRY.checked_options("criterion", self.criterion, self.criterion_options)
        if self.max_loops and self.maps != MapFiles():
            raise ConfigError("Maps of SLAM are loaded and saved without refinement alone; add task=slam.")
