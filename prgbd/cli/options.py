"""``RunOptions``: all options of a run, made once from the configuration, before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal

from prgbd.cli.plugin_choices import CHOICES, DataChoice, DepthChoice, SlamChoice, read_choice
from prgbd.cli.task_options import TASKS, TaskOptions
from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Range, Seed
from prgbd.core.options import from_mapping
from prgbd.core.registry import SHORT_FOR
from prgbd.evaluation.settings import EvaluationSettings
from prgbd.io.export import DEFAULT_FORMATS, check_formats
from prgbd.loop.loop_settings import LoopSettings, SelfImprovement, SensingSettings
from prgbd.training.budget import check_ends
from prgbd.training.pretraining_settings import PretrainingSettings
from prgbd.training.refinement_settings import RefinementSettings

MOST_THREADS = 1024


@dataclass(frozen=True)
class CommonOptions:
    """The options that every run has, whatever its task and plug-ins.

    Attributes:
        seed: Seeds everything random: worlds, RANSAC, sampling, augmentation. Same seed, same machine, same result.
        threads: Processor threads of the depth network, whose number changes the last digits of its sums: null takes
            OMP_NUM_THREADS, or every core. A run that is resumed goes on with as many as it began with.
        out: The run folder; in a multirun the folder of all its runs.
        resume: FOLDER of a run to continue, or last for the newest unfinished one under outputs/.
        debug: Show tracebacks.
        export: Files of SLAM's results: tum, kitti, ply, colmap (text), colmap_images (with keyframe images).
        viz: Watch SLAM: rerun (a recording viz/*.rrd in the run folder) or rerun_live (opens the viewer); extra viz.
        progress: Progress bars: auto (on a terminal), true or false.
        sensing: The depth network as a depth sensor.
        training: Depth refinement; the paper's values are in ``experiment=paper``.
        pretraining: Of ``task=pretrain``; the defaults are Monodepth2's.
        evaluation: Where there is ground truth.

    Raises:
        ConfigError: If a value cannot work.
    """

    seed: Seed = 0
    threads: Annotated[int, Range(1, MOST_THREADS)] | None = None
    out: str = "outputs"
    resume: str | None = None
    debug: bool = False
    export: tuple[str, ...] = DEFAULT_FORMATS
    viz: Literal["none", "rerun", "rerun_live"] | None = "none"
    progress: bool | Literal["auto"] = "auto"
    sensing: SensingSettings = field(default_factory=SensingSettings)
    training: RefinementSettings = field(default_factory=RefinementSettings)
    pretraining: PretrainingSettings = field(default_factory=PretrainingSettings)
    evaluation: EvaluationSettings = field(default_factory=EvaluationSettings)

    def __post_init__(self) -> None:
        object.__setattr__(self, "export", check_formats(self.export))


@dataclass(frozen=True)
class RunOptions(CommonOptions):
    """All options of a run.

    Attributes:
        task: Those of the task, ``task.*``.
        slam: The SLAM system, its options and what the run does with it.
        depth: The same for the depth network.
        data: The same for the recordings.
        criterion: Options of the criterion that ``task.criterion`` names.
    """

    task: TaskOptions = field(default_factory=SelfImprovement)
    slam: SlamChoice = field(default_factory=SlamChoice)
    depth: DepthChoice = field(default_factory=DepthChoice)
    data: DataChoice = field(default_factory=DataChoice)
    criterion: Mapping[str, Any] = field(default_factory=dict)

    @property
    def loop(self) -> LoopSettings:
        """The settings of the loop; without refinements unless the task is to make some."""
        task = self.task if isinstance(self.task, SelfImprovement) else SelfImprovement(max_loops=0)
        return LoopSettings(
            **vars(task),
            criterion_options=self.criterion if self.task is task else {},
            baseline=self.slam.fixed_baseline,
            running_baseline=self.slam.baseline == "running",
            sensing=self.sensing,
            evaluation=self.evaluation,
            seed=self.seed,
            export=self.export,
            maps=self.slam.maps,
        )


def read_options(config: Mapping[str, Any]) -> RunOptions:
    """Make the options of a run from its whole configuration.

    Args:
        config: Plain data, as Hydra composed it or as a run remembers it.

    Raises:
        ConfigError: If an option is unknown or has a value that cannot work.
        DataError: If a map to load is missing.
    """
    chosen: dict[str, Any] = {kind: read_choice(cls, config.get(kind) or {}, kind) for kind, cls in CHOICES.items()}
    common = {option.name: config[option.name] for option in fields(CommonOptions) if option.name in config}
    common["training"] = {**config["training"], **{kind: config.get(kind) or {} for kind in SHORT_FOR}}
    common["criterion"] = config.get("criterion") or {}
    options = from_mapping(RunOptions, {**common, **chosen, "task": _read_task(config["task"])})
    options.loop  # noqa: B018 - what cannot work together is found now, too
    if isinstance(options.task, SelfImprovement):
        check_ends(options.task.budget, options.training.epochs)
        options.training.check_plugins()
    return options


def _read_task(given: Mapping[str, Any]) -> TaskOptions:
    """Make the options of the task; those of another task, as an experiment may set them, have no effect."""
    name = given.get("name")
    if name not in TASKS:
        raise ConfigError(f"There is no task '{name}'; choose {', '.join(TASKS)}.")
    others = {option.name for task in TASKS.values() for option in fields(task)}
    others -= {option.name for option in fields(TASKS[name])}
    own = {key: value for key, value in given.items() if key != "name" and key not in others}
    task: TaskOptions = from_mapping(TASKS[name], own, "task")
    return task
