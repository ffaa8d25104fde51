"""``task=pretrain``: self-supervised training of a depth network with its pose network."""

from __future__ import annotations

import inspect
from dataclasses import fields
from typing import Any

from prgbd.cli.job import Job
from prgbd.cli.task_options import PretrainTask
from prgbd.cli.tasks.depth import evaluate, make_sensor
from prgbd.cli.tasks.reporting import report
from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import ConfigError
from prgbd.loop.interrupts import interruptible
from prgbd.loop.refining import TrainingProgress
from prgbd.training.pretraining import pretrain


def run(job: Job) -> None:
    """Train on all sequences, keep the weights in ``RUN/weights``, and evaluate where there is true depth."""
    estimator = job.parts.estimator
    assert estimator is not None
    assert isinstance(job.options.task, PretrainTask)
    options = weight_options(job.options.task, estimator)
    figures = job.store.step("pretrain", lambda: _train(job, options))
    # What is evaluated is what was stored, be it in half precision or by a run that was stopped after the training.
    estimator.load_weights(job.store.path("weights"))
    before, after = (_loss(figures[key]) for key in ("held_out_before", "held_out_after"))
    weights = job.store.path("weights")
    job.display.say(f"  {figures['steps']} steps: held-out loss {before} -> {after}; weights in {weights}")
    tested = job.parts.test_sequences or job.parts.sequences
    samples = {**figures, "samples": figures["train_samples"]}
    report(job, evaluate(job, [make_sensor(job, sequence) for sequence in tested], training=samples))


def weight_options(task: PretrainTask, estimator: DepthEstimator) -> dict[str, bool]:
    """Return the keyword arguments of the network's ``save_weights``: the options of the task that are no default.

    Raises:
        ConfigError: If the network cannot store its weights in that way.
    """
    known = inspect.signature(estimator.save_weights).parameters
    changed = {f.name: getattr(task, f.name) for f in fields(task) if getattr(task, f.name) != f.default}
    for name, value in changed.items():
        if name not in known:
            raise ConfigError(
                f"{type(estimator).__name__} cannot store its weights with task.{name}={str(value).lower()}, for its "
                f"save_weights() takes no '{name}'; drop the option."
            )
    return changed


def _loss(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.5f}"


def _train(job: Job, weight_options: dict[str, bool]) -> dict[str, Any]:
    estimator, sequences = job.parts.estimator, job.parts.sequences
    assert estimator is not None
    options = job.options.pretraining
    total = options.epochs * sum(len(sequence) - 2 * options.frame_gap for sequence in sequences)
    if options.max_steps > 0:
        total = min(total, options.max_steps * options.batch_size)
    folder = job.store.path("training")
    with interruptible(), job.display.stage("Pre-training", total) as progress:
        shown = job.trainer.extended(TrainingProgress(progress, job.display.say), enable_progress_bar=False)
        figures = pretrain(estimator, sequences, options, folder, shown)
    with job.store.new_folder(job.store.path("weights")) as weights:
        estimator.save_weights(weights, **weight_options)
    return figures
