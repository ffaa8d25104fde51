"""The plug-ins that a configuration asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from prgbd.cli import settings
from prgbd.cli.help import choices
from prgbd.core.errors import ConfigError, DataError, PrgbdError
from prgbd.core.registry import REGISTRY
from prgbd.loop.recordings import check_recordings
from prgbd.loop.seeding import seed_everything
from prgbd.loop.slam_runs import sensor_input

if TYPE_CHECKING:
    from prgbd.core.data import Sequence
    from prgbd.core.depth import DepthEstimator
    from prgbd.core.slam import GeometricSLAM

# What the loop, and not the plug-in, reads from a plug-in's node.
LOOP_KEYS = {
    "slam": ("mode", "baseline", "load_map", "save_map"),
    "depth": ("wrappers",),
    "data": ("sequences", "test_sequences"),
}
MODES = ("auto", "mono", "rgbd", "stereo", "pseudo_rgbd")


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


def make_parts(config: Mapping[str, Any]) -> Parts:
    """Make the plug-ins that the task of a configuration uses.

    Raises:
        ConfigError: If the task needs a plug-in that is not chosen, or an option has a value that cannot work.
        PrgbdError: Whatever the plug-ins complain about: missing data, wrong weights, unknown options.
    """
    task = config["task"]["name"]
    ids = {kind: _id_of(config, kind) for kind in ("slam", "depth", "data")}
    mode = _mode(config, task, ids)
    use_slam = task in ("self_improve", "slam")
    use_depth = task in ("self_improve", "depth", "pretrain") or mode == "pseudo_rgbd"
    if task == "evaluate":
        use_depth = bool(ids["depth"]) or not config["task"].get("trajectory")
    _require_chosen(task, ids, use_slam, use_depth)
    seed_everything(int(config["seed"]))
    sequences, test_sequences = _make_sequences(config, ids["data"])
    parts = Parts(ids, sequences, test_sequences, mode=mode)
    if use_slam:
        parts.baseline = _baseline(config)
        parts.make_slam = _slam_factory(config, ids["slam"])
        with parts.make_slam() as system:  # options and imports are checked now, not after the depth of a whole video
            parts.mode = parts.mode or _mode_of_sequences(sequences, system.modes)
        if parts.mode in ("rgbd", "stereo"):
            for sequence in (*sequences, *test_sequences):
                sensor_input(sequence, parts.mode, parts.baseline)  # refuses recordings without depth or right images
    if use_depth:
        seed_everything(int(config["seed"]))
        parts.estimator = _wrapped(config, REGISTRY.make("depth", ids["depth"], **plugin_options(config, "depth")))
    if task == "self_improve":
        parts.make_baselines = _baselines(config, parts)
        parts.depth_tests = _depth_tests(config, ids["data"])
    parts.ids = {
        "slam": ids["slam"] if use_slam else "",
        "depth": ids["depth"] if use_depth else "",
        "data": ids["data"],
    }
    return parts


def _wrapped(config: Mapping[str, Any], estimator: DepthEstimator) -> DepthEstimator:
    """Put the wrappers of ``depth.wrappers`` around the network."""
    from prgbd.core.wrappers import wrap

    wrappers = config["depth"].get("wrappers") or []
    if not isinstance(wrappers, list | tuple):
        raise ConfigError(f"depth.wrappers is {wrappers!r}; it must be a list such as [flip_averaged].")
    return wrap(estimator, wrappers)


def plugin_options(config: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """Return the keyword arguments of a plug-in: its node without the id and the keys that the loop reads.

    What its YAML asks for (``???``) and nobody gave is left out; the registry says so when it makes the plug-in.
    """
    left_out = ("id", *LOOP_KEYS[kind])
    return {str(key): value for key, value in config[kind].items() if key not in left_out and value != "???"}


def _id_of(config: Mapping[str, Any], kind: str) -> str:
    node = config.get(kind) or {}
    plugin_id = node.get("id", "")
    if node and not plugin_id:
        option = next(iter(node))
        raise ConfigError(f"{kind}.{option} is given but no {kind} is chosen; add {kind}=ID: {_listed(choices(kind))}.")
    return str(plugin_id)


def _require_chosen(task: str, ids: Mapping[str, str], use_slam: bool, use_depth: bool) -> None:
    missing = [kind for kind, used in (("slam", use_slam), ("depth", use_depth)) if used and not ids[kind]]
    if not missing:
        return
    wanted = " and ".join(f"{kind}=ID ({', '.join(choices(kind))})" for kind in missing)
    if task == "evaluate":
        wanted += ", or task.trajectory=FILE"
    raise ConfigError(f"task={task} needs {wanted}; choose, or see --help.")


def _mode(config: Mapping[str, Any], task: str, ids: Mapping[str, str]) -> str:
    """The mode of SLAM as far as the configuration fixes it; "" leaves it to the recordings."""
    mode = str((config.get("slam") or {}).get("mode", "auto"))
    if mode not in MODES:
        raise ConfigError(f"slam.mode={mode} is unknown; choose {', '.join(MODES)}.")
    if task == "self_improve":
        if mode not in ("auto", "pseudo_rgbd"):
            raise ConfigError(
                f"The self-improving loop runs SLAM on the network's depth, so slam.mode={mode} cannot be used; "
                "drop it, or add task=slam for one SLAM run."
            )
        return "pseudo_rgbd"
    if task != "slam":
        return ""
    if mode == "auto":
        return "pseudo_rgbd" if ids["depth"] else ""
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


def _baseline(config: Mapping[str, Any]) -> float | None:
    value = config["slam"].get("baseline", "auto")
    if value in (None, "auto", "adaptive", "running"):
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        raise ConfigError(f"slam.baseline={value} cannot be used; give a positive number of metres, auto, or running.")
    return float(value)


def _slam_factory(config: Mapping[str, Any], plugin_id: str) -> Callable[[], GeometricSLAM]:
    options = plugin_options(config, "slam")

    def make() -> GeometricSLAM:
        system: GeometricSLAM = REGISTRY.make("slam", plugin_id, **options)
        return system

    return make


def _baselines(config: Mapping[str, Any], parts: Parts) -> dict[str, Callable[[], GeometricSLAM]]:
    """Return what makes the baselines: the run's own SLAM for ``mono``, and the pose network beside depth.weights."""
    made: dict[str, Callable[[], GeometricSLAM]] = {}
    for kind in settings.baselines(config):
        if kind == "mono":
            assert parts.make_slam is not None
            made[kind] = parts.make_slam
            continue
        options = {"depth": parts.ids["depth"], "weights": config["depth"].get("weights")}
        made[kind] = partial(REGISTRY.make, "slam", "posenet", **options)
        try:
            made[kind]().close()  # weights without a pose network are found now, not after hours of other baselines
        except PrgbdError as error:
            raise type(error)(f"task.baselines=[posenet] cannot run: {error}") from error
    return made


def _make_sequences(config: Mapping[str, Any], plugin_id: str) -> tuple[list[Sequence], list[Sequence]]:
    if not plugin_id:
        raise ConfigError(f"No data is chosen; add data=ID: {_listed(choices('data'))}.")
    options = plugin_options(config, "data")
    sequences = REGISTRY.make_sequences(plugin_id, _names(config, "sequences"), **options)
    test_names = _names(config, "test_sequences")
    test_sequences = REGISTRY.make_sequences(plugin_id, test_names, **options) if test_names else []
    check_recordings([*sequences, *test_sequences])
    return sequences, test_sequences


def _depth_tests(config: Mapping[str, Any], plugin_id: str) -> list[Sequence]:
    """Make the images of ``evaluation.depth_test``: all recordings of the same plug-in under other options.

    Raises:
        ConfigError: If the option is no mapping or changes nothing.
        DataError: If the images have no true depth.
    """
    changes = config["evaluation"].get("depth_test")
    if changes is None:
        return []
    options = plugin_options(config, "data")
    if not isinstance(changes, Mapping) or not changes or all(options.get(k) == v for k, v in changes.items()):
        raise ConfigError(
            f"evaluation.depth_test is {changes!r}; give options of data={plugin_id} that name other images, such as "
            "{split: test_files.txt}."
        )
    found = REGISTRY.make_sequences(plugin_id, None, **{**options, **changes})
    if not any(sequence.depth(index) is not None for sequence in found for index in {0, len(sequence) - 1}):
        raise DataError(f"The images of evaluation.depth_test={dict(changes)} have no true depth; name others.")
    return found


def _names(config: Mapping[str, Any], key: str) -> list[str] | None:
    """Names of recordings as strings: Hydra reads ``10`` as a number and ``00`` as text."""
    value = config["data"].get(key)
    if value is None:
        return None
    return [str(name) for name in (value if isinstance(value, list | tuple) else [value])]


def _listed(names: list[str]) -> str:
    return ", ".join(names)
