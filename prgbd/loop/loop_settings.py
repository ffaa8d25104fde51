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
        max_loops: Refinements of the network at most (the paper: 5 on KITTI, 3 on TUM).
        min_improvement: Stop, and go back to the best loop, unless the criterion drops by more than this fraction; null
            never stops early and keeps the last loop, so that all runs of an ablation end after the same loop.
        criterion: What decides whether a loop helped, the id of a plug-in: held_out (the loss of the refinement on
            held-out keyframes), slam (what SLAM made of the refined network), both, or that of another package.
        patience: Go on after so many loops in a row that SLAM's evidence calls no better; the best one is kept anyway.
        first_teacher: What the first refinement learns from: pseudo_rgbd, SLAM on the network's depth as in all later
            ones (the paper), or mono, SLAM on the images alone, for a network that does not know the scene yet.
        baselines: Further rows of the tables, on the test recordings or, without any, on all: mono (slam= on the images
            alone, the paper's RGB ORB-SLAM) and posenet (the pose network that lies beside depth.weights, its motions
            chained).

    Raises:
        ConfigError: If a value cannot work.
    """

    name: ClassVar[str] = "self_improve"

    max_loops: CountOrZero = 3
    min_improvement: Annotated[float, Range(0, 1, without=1)] | None = 0.0
    criterion: str = "held_out"
    patience: CountOrZero = 0
    first_teacher: Literal["pseudo_rgbd", "mono"] = "pseudo_rgbd"
    baselines: tuple[Literal["mono", "posenet"], ...] = ()

    def __post_init__(self) -> None:
        check_types(self, "task")

    @property
    def all_baselines(self) -> tuple[str, ...]:
        """The baselines that run beside the loop; one that teaches the network is among them."""
        teacher = ("mono",) if self.first_teacher == "mono" else ()
        return tuple(dict.fromkeys((*self.baselines, *teacher)))


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
