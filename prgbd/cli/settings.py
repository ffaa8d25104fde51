"""From the configuration to the settings of the parts: names and types checked, one sentence for what is wrong."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prgbd.cli.loggers import logger_maker
from prgbd.cli.option_values import number, typed_options, whole
from prgbd.core.errors import ConfigError, DataError

if TYPE_CHECKING:
    from prgbd.cli.parts import Parts
    from prgbd.core.computing import Computing
    from prgbd.core.depth import DepthEstimator
    from prgbd.loop.depth_figures import DepthProtocol
    from prgbd.loop.loop_settings import LoopSettings
    from prgbd.loop.slam_runs import MapFiles
    from prgbd.loop.summary import RunIdentity
    from prgbd.loop.viewing import ViewerMaker
    from prgbd.training.pretraining_settings import PretrainingSettings
    from prgbd.training.refinement_settings import RefinementSettings
    from prgbd.training.trainers import TrainerFactory


BASELINES = ("mono", "posenet")
TASKS = ("self_improve", "slam", "depth", "evaluate", "pretrain")

WEIGHT_OPTIONS = {"half": False, "pose": True}
"""Options of ``task=pretrain`` that go to the network's ``save_weights``, with what it does without them."""


def check_settings(config: Mapping[str, Any]) -> None:
    """Read every setting that a run will need, so that a wrong one is found before anything is computed.

    Raises:
        ConfigError: If an option is unknown or has a value that cannot work.
    """
    task = config["task"].get("name")
    if task not in TASKS:
        raise ConfigError(f"There is no task '{task}'; choose {', '.join(TASKS)}.")
    seed = config["seed"]
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ConfigError(f"seed is {seed!r}; it must be a whole number, 0 or more.")
    loop_settings(config, None)
    viewer_maker(config)
    _check_cache(config)
    if task == "self_improve":
        refinement_settings(config)
        baselines(config)
    if task == "pretrain":
        pretraining_settings(config)
        for name in WEIGHT_OPTIONS:
            _flag(config, name)
    trains = task in ("self_improve", "pretrain")
    if trains or config.get("depth"):
        trainer_factory(config).check(trains=trains)


def _check_cache(config: Mapping[str, Any]) -> None:
    cache = config["sensing"].get("cache")
    if cache is None:
        return
    try:
        Path(cache).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"sensing.cache={cache} cannot be made ({error.strerror}); choose another folder.") from error


def trainer_factory(config: Mapping[str, Any]) -> TrainerFactory:
    """Return the Lightning configuration of ``trainer`` with the loggers of ``logger``.

    Raises:
        ConfigError: If the logger is unknown or its package is missing.
    """
    from prgbd.training.trainers import TrainerFactory

    return TrainerFactory(config["trainer"], make_logger=logger_maker(config))


def refinement_settings(config: Mapping[str, Any]) -> RefinementSettings:
    """Make the settings of the refinement from ``loss``, ``training`` and ``seed``.

    Raises:
        ConfigError: If an option is unknown or has a value that cannot work.
    """
    from prgbd.training.refinement_settings import RefinementSettings

    seed = {"seed": config["seed"]}
    return RefinementSettings(
        **seed,
        **typed_options(RefinementSettings, config["loss"], "loss"),
        **typed_options(RefinementSettings, config["training"], "training"),
    )


def pretraining_settings(config: Mapping[str, Any]) -> PretrainingSettings:
    """Make the settings of pre-training from ``pretraining`` and ``seed``.

    Raises:
        ConfigError: If an option is unknown or has a value that cannot work.
    """
    from prgbd.training.pretraining_settings import PretrainingSettings

    options = typed_options(PretrainingSettings, config["pretraining"], "pretraining")
    return PretrainingSettings(seed=config["seed"], **options)


def weight_options(config: Mapping[str, Any], estimator: DepthEstimator) -> dict[str, bool]:
    """Return the keyword arguments of the network's ``save_weights`` from ``task.half`` and ``task.pose``.

    Raises:
        ConfigError: If the network cannot store its weights in that way, or a value is neither true nor false.
    """
    known = inspect.signature(estimator.save_weights).parameters
    options = {}
    for name, default in WEIGHT_OPTIONS.items():
        value = _flag(config, name)
        if value == default:
            continue
        if name not in known:
            raise ConfigError(
                f"{type(estimator).__name__} cannot store its weights with task.{name}={str(value).lower()}, for its "
                f"save_weights() takes no '{name}'; drop the option."
            )
        options[name] = value
    return options


def _flag(config: Mapping[str, Any], name: str) -> bool:
    value = config["task"].get(name, WEIGHT_OPTIONS[name])
    if not isinstance(value, bool):
        raise ConfigError(f"task.{name} is {value!r}; it must be true or false.")
    return value


def loop_settings(config: Mapping[str, Any], baseline: float | None) -> LoopSettings:
    """Make the settings of the loop; ``baseline`` is the virtual baseline that the user fixed, or None.

    Raises:
        ConfigError: If a value cannot work.
    """
    from prgbd.loop.loop_settings import LoopSettings

    cache = config["sensing"].get("cache")
    return LoopSettings(
        max_loops=whole(number({"task": {"max_loops": 0} | config["task"]}, "task.max_loops"), "task.max_loops"),
        min_improvement=number(
            {"task": {"min_improvement": 0.0} | config["task"]}, "task.min_improvement", optional=True
        ),
        criterion=str(config["task"].get("criterion", "held_out")),
        first_teacher=str(config["task"].get("first_teacher", "pseudo_rgbd")),
        patience=whole(number({"task": {"patience": 0} | config["task"]}, "task.patience"), "task.patience"),
        baseline=baseline,
        running_baseline=(config.get("slam") or {}).get("baseline") == "running",
        baseline_percentile=float(number(config, "sensing.baseline_percentile")),
        batch_size=batch_size(config),
        computing=computing(config),
        cache=None if cache is None else Path(cache),
        depth=depth_protocol(config),
        alignment=alignment(config),
        seed=int(config["seed"]),
        export=export_formats(config),
        maps=map_files(config),
    )


def map_files(config: Mapping[str, Any]) -> MapFiles:
    """Read where SLAM's maps come from and go to.

    Raises:
        ConfigError: If a value is no file name, or one file would have to take the maps of several recordings.
        DataError: If the map to load is missing.
    """
    from prgbd.loop.slam_runs import MapFiles

    node = config.get("slam") or {}
    load, save = node.get("load_map"), node.get("save_map") or False
    if load is not None and not (isinstance(load, str) and load):
        raise ConfigError(f"slam.load_map is {load!r}; it must be a file that slam.save_map made.")
    if load is not None and not Path(load).is_file():
        raise DataError(f"There is no map {load}; make one with slam.save_map.")
    if not isinstance(save, bool | str):
        raise ConfigError(f"slam.save_map is {save!r}; it must be true, false or a file.")
    return MapFiles(None if load is None else Path(load), save if isinstance(save, bool) else Path(save))


def export_formats(config: Mapping[str, Any]) -> tuple[str, ...]:
    """Read in which formats SLAM's results are written.

    Raises:
        ConfigError: If one is unknown.
    """
    from prgbd.io.export import DEFAULT_FORMATS, check_formats

    return check_formats(config.get("export", DEFAULT_FORMATS) or ())


def viewer_maker(config: Mapping[str, Any]) -> ViewerMaker | None:
    """Return what makes viewers of SLAM runs, None for ``viz=none``.

    Raises:
        ConfigError: If the choice is unknown or its package is missing.
    """
    from prgbd.loop.viewing import viewer_maker

    return viewer_maker(str(config.get("viz") or "none"))


def baselines(config: Mapping[str, Any]) -> list[str]:
    """Read which baselines ``task=self_improve`` runs beside the loop; one that teaches the network is among them.

    Raises:
        ConfigError: If one is unknown.
    """
    value = config["task"].get("baselines") or []
    if not isinstance(value, list | tuple) or not set(value) <= set(BASELINES):
        raise ConfigError(f"task.baselines is {value!r}; give a list of {' and '.join(BASELINES)}, such as [mono].")
    teacher = ["mono"] if config["task"].get("first_teacher") == "mono" else []
    return [str(name) for name in dict.fromkeys([*value, *teacher])]


def alignment(config: Mapping[str, Any]) -> str:
    """Read how trajectories are aligned with the truth.

    Raises:
        ConfigError: If the choice is unknown.
    """
    value, known = str(config["evaluation"]["alignment"]), ("sim3", "se3", "none")
    if value not in known:
        raise ConfigError(f"evaluation.alignment is '{value}'; choose {', '.join(known)}.")
    return value


def depth_protocol(config: Mapping[str, Any]) -> DepthProtocol:
    """Read how depth is compared with the truth.

    Raises:
        ConfigError: If a value cannot work.
    """
    from prgbd.loop.depth_figures import DepthProtocol

    images = number(config, "evaluation.depth_images", optional=True)
    median_scaling = config["evaluation"].get("median_scaling", True)
    if not isinstance(median_scaling, bool):
        raise ConfigError(f"evaluation.median_scaling is {median_scaling!r}; it must be true or false.")
    return DepthProtocol(
        images=None if images is None else whole(images, "evaluation.depth_images"),
        cap=float(number(config, "evaluation.depth_cap")),
        crop=str(config["evaluation"]["depth_crop"]),
        median_scaling=median_scaling,
        caps=_depths(config, "depth_caps"),
        bins=_depths(config, "depth_bins"),
    )


def _depths(config: Mapping[str, Any], name: str) -> tuple[float, ...] | None:
    """Read a list of depths in metres, None for auto."""
    value = config["evaluation"].get(name, "auto")
    if value in (None, "auto"):
        return None
    if not isinstance(value, list | tuple):
        raise ConfigError(f"evaluation.{name} is {value!r}; give a list of metres such as [30,50,80], or auto.")
    if any(isinstance(item, bool) or not isinstance(item, int | float) for item in value):
        raise ConfigError(f"evaluation.{name} is {list(value)}; its entries must be numbers of metres.")
    return tuple(float(item) for item in value)


def batch_size(config: Mapping[str, Any]) -> int | None:
    """Return the sensor's batch size, None for auto."""
    if config["sensing"].get("batch_size") in (None, "auto"):
        return None
    size = whole(number(config, "sensing.batch_size"), "sensing.batch_size")
    if size < 1:
        raise ConfigError(f"sensing.batch_size is {size}; it must be at least 1.")
    return size


def computing(config: Mapping[str, Any]) -> Computing:
    """Return how the sensor's network is computed.

    Raises:
        ConfigError: If a value cannot work.
    """
    from prgbd.core.computing import Computing

    names = [field.name for field in fields(Computing)]
    return Computing(**{name: config["sensing"][name] for name in names if name in config["sensing"]})


def identity(config: Mapping[str, Any], parts: Parts) -> RunIdentity:
    """Return what the run is about."""
    from prgbd.loop.summary import RunIdentity

    ids = parts.ids
    return RunIdentity(config["task"]["name"], ids["slam"], ids["depth"], ids["data"], int(config["seed"]))
