"""``task=pretrain``: self-supervised training of a depth network with its pose network."""

from __future__ import annotations

from typing import Any

from prgbd.cli import settings
from prgbd.cli.job import Job
from prgbd.cli.tasks.depth import evaluate, make_sensor
from prgbd.cli.tasks.reporting import report
from prgbd.loop.interrupts import interruptible
from prgbd.loop.refining import TrainingProgress
from prgbd.training.pretraining import pretrain


def run(job: Job) -> None:
    """Train on all sequences, keep the weights in ``RUN/weights``, and evaluate where there is true depth."""
    estimator = job.parts.estimator
    assert estimator is not None
    options = settings.weight_options(job.config, estimator)
    figures = job.store.step("pretrain", lambda: _train(job, options))
    # What is evaluated is what was stored, be it in half precision or by a run that was stopped after the training.
    estimator.load_weights(job.store.path("weights"))
    before, after = (_loss(figures[key]) for key in ("held_out_before", "held_out_after"))
    weights = job.store.path("weights")
    job.display.say(f"  {figures['steps']} steps: held-out loss {before} -> {after}; weights in {weights}")
    tested = job.parts.test_sequences or job.parts.sequences
    samples = {**figures, "samples": figures["train_samples"]}
    report(job, evaluate(job, [make_sensor(job, sequence) for sequence in tested], training=samples))


def _loss(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.5f}"


def _train(job: Job, weight_options: dict[str, bool]) -> dict[str, Any]:
    estimator, sequences = job.parts.estimator, job.parts.sequences
    assert estimator is not None
    options = settings.pretraining_settings(job.config)
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
