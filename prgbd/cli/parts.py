"""The plug-ins that a configuration asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from prgbd.cli.arguments import PLUGIN_GROUPS
from prgbd.cli.help import choices
from prgbd.cli.options import RunOptions
from prgbd.cli.plugin_choices import DataChoice
from prgbd.cli.task_options import EvaluateTask
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.option_errors import listed
from prgbd.core.registry import REGISTRY
from prgbd.core.wrappers import wrap
from prgbd.loop.baselines import baseline_makers
from prgbd.loop.loop_settings import SelfImprovement
from prgbd.loop.recordings import check_recordings
from prgbd.loop.seeding import seed_everything
from prgbd.loop.slam_runs import sensor_input

if TYPE_CHECKING:
    from prgbd.core.data import Sequence
    from prgbd.core.depth import DepthEstimator
    from prgbd.core.slam import GeometricSLAM


WITHOUT_FILES = "synthetic"
"""The recordings that are taken where no ``data=`` is given; whoever forgets it has files of their own."""


@dataclass
class Parts:
    """The plug-ins of a run, made and checked.

    Attributes:
        ids: Ids of the plug-ins by kind; "" where none is used.
        sequences: Recordings to run on (and train on).
        test_sequences: Recordings that are evaluated but not trained on.
        depth_tests: Images whose depth is evaluated in every loop, by ``evaluation.depth_test``.
        estimator: The depth network, where the task uses one.
        make_slam: Makes a SLAM system, where the task uses one.
        mode: ``mono``, ``rgbd`` (the sensor's depth), ``stereo`` or ``pseudo_rgbd`` (the network's depth).
        baseline: The baseline that the user fixed, metres, or None.
        make_baselines: Makes the system of each of ``task.baselines``, by its name.
    """

    ids: dict[str, str]
    sequences: list[Sequence]
    test_sequences: list[Sequence] = field(default_factory=list)
    depth_tests: list[Sequence] = field(default_factory=list)
    estimator: DepthEstimator | None = None
    make_slam: Callable[[], GeometricSLAM] | None = None
    mode: str = ""
    baseline: float | None = None
    make_baselines: dict[str, Callable[[], GeometricSLAM]] = field(default_factory=dict)


def make_parts(options: RunOptions) -> Parts:
    """Make the plug-ins that the task of a run uses.

    Raises:
        ConfigError: If the task needs a plug-in that is not chosen, or an option has a value that cannot work.
        PrgbdError: Whatever the plug-ins complain about: missing data, wrong weights, unknown options.
    """
    task = options.task.name
    ids = {kind: _id_of(options, kind) for kind in PLUGIN_GROUPS}
    mode = _mode(options)
    use_slam = task in ("self_improve", "slam")
    use_depth = task in ("self_improve", "depth", "pretrain") or mode == "pseudo_rgbd"
    if isinstance(options.task, EvaluateTask):
        use_depth = bool(options.depth.id) or options.task.trajectory is None
    _require_chosen(task, ids, use_slam, use_depth)
    seed_everything(options.seed)
    sequences, test_sequences = _make_sequences(options.data)
    parts = Parts(ids, sequences, test_sequences, mode=mode)
    if use_slam:
        parts.baseline = options.slam.fixed_baseline
        parts.make_slam = partial(REGISTRY.make, "slam", options.slam.id, **options.slam.options)
        with parts.make_slam() as system:  # options and imports are checked now, not after the depth of a whole video
            parts.mode = parts.mode or _mode_of_sequences(sequences, system.modes)
        if parts.mode in ("rgbd", "stereo"):
            for sequence in (*sequences, *test_sequences):
                sensor_input(sequence, parts.mode, parts.baseline)  # refuses recordings without depth or right images
    if use_depth:
        seed_everything(options.seed)
        network = REGISTRY.make("depth", options.depth.id, **options.depth.options)
        parts.estimator = wrap(network, options.depth.wrappers or [])
    if isinstance(options.task, SelfImprovement):
        assert parts.make_slam is not None
        network = {"id": options.depth.id, **options.depth.options}
        parts.make_baselines = baseline_makers(options.task.baselines, parts.make_slam, network)
        parts.depth_tests = _depth_tests(options)
    parts.ids = {
        "slam": ids["slam"] if use_slam else "",
        "depth": ids["depth"] if use_depth else "",
        "data": ids["data"],
    }
    return parts


def _id_of(options: RunOptions, kind: str) -> str:
    choice = getattr(options, kind)
    if choice.options and not choice.id:
        option = next(iter(choice.options))
        raise ConfigError(f"{kind}.{option} is given but no {kind} is chosen; add {kind}=ID: {listed(choices(kind))}.")
    return str(choice.id)


def _require_chosen(task: str, ids: Mapping[str, str], use_slam: bool, use_depth: bool) -> None:
    missing = [kind for kind, used in (("slam", use_slam), ("depth", use_depth)) if used and not ids[kind]]
    if not missing:
        return
    wanted = " and ".join(f"{kind}=ID ({', '.join(choices(kind))})" for kind in missing)
    if task == "evaluate":
        wanted += ", or task.trajectory=FILE"
    raise ConfigError(f"task={task} needs {wanted}; choose, or see --help.")


def _mode(options: RunOptions) -> str:
    """The mode of SLAM as far as the options fix it; "" leaves it to the recordings."""
    mode = options.slam.mode
    if options.task.name == "self_improve":
        if mode not in ("auto", "pseudo_rgbd"):
            raise ConfigError(
                f"The self-improving loop runs SLAM on the network's depth, so slam.mode={mode} cannot be used; "
                "drop it, or add task=slam for one SLAM run."
            )
        return "pseudo_rgbd"
    if options.task.name != "slam":
        return ""
    if mode == "auto":
        return "pseudo_rgbd" if options.depth.id else ""
    return mode


def _mode_of_sequences(sequences: list[Sequence], modes: frozenset[str]) -> str:
    """The mode that uses most of what all recordings have, and that the system knows if it is stereo."""
    if all(sequence.frame(0).depth is not None for sequence in sequences):
        return "rgbd"
    return "stereo" if "stereo" in modes and all(_is_stereo(sequence) for sequence in sequences) else "mono"


def _is_stereo(sequence: Sequence) -> bool:
    """Whether the right images reach from the first frame to the last: downloads that broke off have fewer."""
    ends = (0, len(sequence) - 1)
    return bool(sequence.baseline) and all(sequence.frame(index).right is not None for index in ends)


def _make_sequences(choice: DataChoice) -> tuple[list[Sequence], list[Sequence]]:
    if not choice.id:
        raise ConfigError(f"No data is chosen; add data=ID: {listed(choices('data'))}.")
    if choice.id == WITHOUT_FILES and "root" in choice.options:
        root = str(choice.options["root"])
        kind = "images" if Path(root).expanduser().is_dir() else "video"
        raise ConfigError(f"data.root={root} is given, but data={choice.id} draws its own world; add data={kind}.")
    sequences = REGISTRY.make_sequences(choice.id, names_of(choice.sequences), **choice.options)
    test_names = names_of(choice.test_sequences)
    test_sequences = REGISTRY.make_sequences(choice.id, test_names, **choice.options) if test_names else []
    check_recordings([*sequences, *test_sequences])
    return sequences, test_sequences


def _depth_tests(options: RunOptions) -> list[Sequence]:
    """Make the images of ``evaluation.depth_test``: all recordings of the same plug-in under other options.

    Raises:
        ConfigError: If the option changes nothing.
        DataError: If the images have no true depth.
    """
    changes, given = options.evaluation.depth_test, options.data.options
    if changes is None:
        return []
    if all(given.get(key) == value for key, value in changes.items()):
        raise ConfigError(
            f"evaluation.depth_test is {changes}; give options of data={options.data.id} that name other images, such "
            "as {split: test_files.txt}."
        )
    found = REGISTRY.make_sequences(options.data.id, None, **{**given, **changes})
    if not any(sequence.depth(index) is not None for sequence in found for index in {0, len(sequence) - 1}):
        raise DataError(f"The images of evaluation.depth_test={changes} have no true depth; name others.")
    return found


def names_of(value: list[str] | str | None) -> list[str] | None:
    """Return the names of recordings that ``data.sequences`` gives, None for all."""
    return [value] if isinstance(value, str) else value
