"""``prgbd.improve``: the self-improving loop from Python."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from collections.abc import Sequence as Many
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prgbd.core.errors import ConfigError, PartlyFailedError
from prgbd.core.options import from_mapping
from prgbd.evaluation.settings import EvaluationSettings
from prgbd.io.files import to_plain
from prgbd.loop.baselines import baseline_makers
from prgbd.loop.improvement import Improvement
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.loop_settings import LoopSettings, SelfImprovement, SensingSettings
from prgbd.loop.monitor import Monitor, PrintingMonitor
from prgbd.loop.outcome import failure
from prgbd.loop.plugin_objects import GivenData, GivenDepth, GivenSlam, make_network, make_recordings, slam_maker
from prgbd.loop.recordings import check_recordings
from prgbd.loop.seeding import seed_everything
from prgbd.loop.self_improving import SelfImprovingLoop
from prgbd.loop.store import DONE, RunStore
from prgbd.loop.summary import RunIdentity, write_results
from prgbd.training.budget import check_ends
from prgbd.training.objective import METHOD
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.trainers import TrainerFactory

if TYPE_CHECKING:
    from lightning.pytorch.callbacks import Callback

log = logging.getLogger("prgbd")
Options = Mapping[str, Any]


def improve(
    data: GivenData,
    *,
    depth: GivenDepth,
    slam: GivenSlam = "orb_gtsam",
    test: GivenData = (),
    trainer: TrainerFactory | Options | None = None,
    callbacks: Many[Callback] = (),
    out: Path | str | None = None,
    resume: bool = False,
    max_loops: int | None = None,
    task: Options | None = None,
    training: Options | None = None,
    loss: Options | None = None,
    augmentation: Options | None = None,
    criterion: Options | None = None,
    sensing: Options | None = None,
    evaluation: Options | None = None,
    seed: int = 0,
    monitor: Monitor | None = None,
) -> Improvement:
    """Let a depth network and a SLAM system improve each other on unlabelled recordings.

    The same as ``task=self_improve`` on the command line, with the same names, defaults and results, for plug-ins by
    id and for objects of one's own.

    Args:
        data: Recordings to learn from: objects, or plug-ins by id; an id without options means all that it has.
        depth: The network: an object, which is trained in place, what makes it, or a plug-in by id.
        slam: The SLAM system: its class, or a function that makes it, or a plug-in by id. One is made for every run.
        test: Recordings that are evaluated in every loop but not learnt from.
        trainer: Options of ``lightning.Trainer`` for every step: accelerator, devices, precision, loggers, ...
        callbacks: Lightning callbacks of every refinement.
        out: Folder of the run; by default a new one in ``outputs``.
        resume: Go on with the run in ``out``, if there is one that began with the same weights.
        max_loops: Refinements at most; short for ``task={"max_loops": ...}``.
        task: Options of the loop, such as ``criterion`` and ``patience``.
        training: Options of the refinement, such as ``learning_rate`` and ``epochs``.
        loss: Weights or options of loss terms by their names, besides the method's own.
        augmentation: Options of augmentations by their names.
        criterion: Options of the criterion that ``task`` names.
        sensing: Options of the network as a sensor, such as ``precision``.
        evaluation: How depth and trajectories are compared with the truth, where there is any.
        seed: Seeds everything random.
        monitor: Who watches; by default every step is printed.

    Returns:
        The improved network, all figures, and where the report lies.

    Raises:
        PrgbdError: If something that the caller can mend is wrong; what was finished is kept in the folder.
    """
    factory = trainer if isinstance(trainer, TrainerFactory) else TrainerFactory(trainer or {})
    factory = factory.extended(*callbacks)
    factory.check()
    task = {**(task or {}), **({} if max_loops is None else {"max_loops": max_loops})}
    settings = LoopSettings(
        **vars(from_mapping(SelfImprovement, task, "task")),
        criterion_options=criterion or {},
        sensing=from_mapping(SensingSettings, sensing or {}, "sensing"),
        evaluation=from_mapping(EvaluationSettings, evaluation or {}, "evaluation"),
        seed=seed,
    )
    if settings.evaluation.depth_test is not None:
        raise ConfigError(
            "evaluation.depth_test names options of data=, which improve has not; give recordings as test=."
        )
    plugins = {"loss": {**METHOD, **(loss or {})}, "augmentation": augmentation or {}}
    refinement = from_mapping(RefinementSettings, {"seed": seed, **plugins, **(training or {})}, "training")
    refinement.check_plugins()
    check_ends(settings.budget, refinement.epochs)
    seed_everything(seed)
    sequences, learnt = make_recordings(data)
    test_sequences, tested = make_recordings(test)
    check_recordings([*sequences, *test_sequences])
    make_slam, system = slam_maker(slam)
    seed_everything(seed)
    estimator, network = make_network(depth)
    chosen = {"slam": system, "depth": network, "data": learnt, "test": tested, "seed": seed}
    config = chosen | {"task": asdict(settings), "training": asdict(refinement), "trainer": dict(factory.options)}
    parts = LoopParts(
        estimator=estimator,
        make_slam=make_slam,
        sequences=sequences,
        settings=settings,
        store=_store(out, config, resume=resume),
        identity=RunIdentity("self_improve", system["id"], network["id"], learnt["id"], seed),
        refinement=refinement,
        trainer=factory,
        test_sequences=test_sequences,
        baselines=baseline_makers(settings.baselines, make_slam, network),
        monitor=monitor or PrintingMonitor(),
    )
    try:
        summary = SelfImprovingLoop(parts).run()
        report = write_results(parts.store, summary)
        loop_failed = failure(summary)
        if not isinstance(loop_failed, PartlyFailedError):
            parts.store.finish(DONE)
        if loop_failed is not None:
            log.warning("%s", loop_failed)
    finally:
        parts.store.close()
    return Improvement(estimator, summary, parts.store.folder, report)


def _store(out: Path | str | None, config: Options, *, resume: bool) -> RunStore:
    """Begin a run, or open the one to go on with.

    Raises:
        ConfigError: If there is a run where a new one is to begin, none to go on with, or one with other options.
    """
    folder = Path(out or time.strftime("outputs/%Y-%m-%d/%H-%M-%S"))
    plain = _plain(config)
    if not resume:
        return RunStore.create(folder, plain)
    store = RunStore.open(folder)
    other = [key for key, value in plain.items() if key != "trainer" and store.config.get(key) != value]
    if other:
        store.close()
        raise ConfigError(
            f"The run in {folder} was started with other options ({', '.join(other)}); give the same, or another out."
        )
    return store


def _plain(value: Any) -> Any:
    """Return options as plain data; the name of its class stands for an object."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    try:
        return to_plain(value)
    except TypeError:
        return type(value).__name__
