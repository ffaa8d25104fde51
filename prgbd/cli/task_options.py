"""The options ``task.*`` of every task; those of ``task=self_improve`` belong to the loop."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from prgbd.core.option_ranges import Count, Positive
from prgbd.loop.loop_settings import SelfImprovement


@dataclass(frozen=True)
class SlamTask:
    """Options of ``task=slam``: one SLAM run per sequence."""

    name: ClassVar[str] = "slam"


@dataclass(frozen=True)
class DepthTask:
    """Options of ``task=depth``: depth of every frame, a 16-bit PNG (value / png_scale = depth) and a colour preview.

    Attributes:
        png_scale: What depth is multiplied by in the PNG files; as KITTI, metres = value / 256.
        npz: Write the float32 maps as compressed NumPy files as well.
        every: Every n-th frame.

    Raises:
        ConfigError: If a value cannot work.
    """

    name: ClassVar[str] = "depth"
    png_scale: Positive = 256.0
    npz: bool = False
    every: Count = 1


@dataclass(frozen=True)
class EvaluateTask:
    """Options of ``task=evaluate``: depth metrics of a network, and / or pose metrics of a trajectory file.

    Attributes:
        trajectory: A trajectory file (TUM or KITTI format) of one sequence.
    """

    name: ClassVar[str] = "evaluate"
    trajectory: Path | None = None


@dataclass(frozen=True)
class PretrainTask:
    """Options of ``task=pretrain``: self-supervised training of a network with its pose network.

    Attributes:
        half: Store the weights as float16, half the size, where the network can.
        pose: Store the pose network as well; false, where the network can, for weights that only predict depth.
    """

    name: ClassVar[str] = "pretrain"
    half: bool = False
    pose: bool = True


TaskOptions = SelfImprovement | SlamTask | DepthTask | EvaluateTask | PretrainTask
TASKS: dict[str, type[Any]] = {
    task.name: task for task in (SelfImprovement, SlamTask, DepthTask, EvaluateTask, PretrainTask)
}
