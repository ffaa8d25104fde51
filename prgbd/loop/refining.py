"""One depth refinement as a step of the loop: what it is given, what it leaves in the run's folder."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lightning.pytorch.callbacks import Callback

from prgbd.core.errors import SlamError
from prgbd.io.files import atomic_path
from prgbd.loop.interrupts import interruptible
from prgbd.loop.lessons import Lesson
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.monitor import Progress
from prgbd.loop.sigma_learning import keyframes_apart, learn_sigma
from prgbd.training.refinement import RefinementOutcome, refine
from prgbd.training.refinement_settings import RefinementSettings


class TrainingProgress(Callback):
    """Tells a ``Progress`` of every training step, and a training that goes on where it does so.

    Args:
        progress: Counts samples.
        say: Tells one line.
    """

    def __init__(self, progress: Progress, say: Callable[[str], None]) -> None:
        self._progress: Progress | None = progress
        self._say: Callable[[str], None] | None = say

    def __getstate__(self) -> dict[str, Any]:
        """Leave the terminal behind on the way to a spawned process."""
        return {"_progress": None, "_say": None}

    def on_train_start(self, trainer: Any, pl_module: Any) -> None:
        """Say where a training goes on that was stopped."""
        if self._progress is None or self._say is None or not trainer.global_step:
            return
        batches = trainer.fit_loop.epoch_loop.batch_progress.total.processed
        self._progress.advance(batches * (trainer.train_dataloader.batch_size or 1))
        self._say(f"  the training goes on at step {trainer.global_step + 1} of {trainer.estimated_stepping_batches}")

    def on_train_batch_end(self, trainer: Any, pl_module: Any, outputs: Any, batch: Any, batch_idx: int) -> None:
        """Count the samples of a step."""
        if self._progress is not None:
            self._progress.advance(len(batch[0]), loss=f"{float(outputs['loss']):.4f}")


def refine_in_run(parts: LoopParts, lesson: Lesson, loop: int) -> dict[str, Any] | None:
    """Fine-tune the network in place; leave ``training/losses.csv`` and ``weights/`` in the loop's folder.

    Where the network predicts how wrong its depth is, it learns that from the same results of SLAM.

    Args:
        parts: What the loop works with; the network has the weights that SLAM ran with.
        lesson: Recordings, what SLAM made of them, and how long to learn from it.
        loop: Number of the loop.

    Returns:
        The figures of the training, or None if SLAM's output holds nothing to learn from.
    """
    estimator, store, monitor, plan = parts.estimator, parts.store, parts.monitor, lesson.plan
    settings, supervised = plan.settings, lesson.supervised
    if settings.learn == "uncertainty":
        figures = learn_sigma(estimator, supervised, keyframes_apart(supervised, settings.val_fraction))
        if figures is not None:
            _store_weights(parts, loop)
        return figures
    folder = store.loop(loop, "training")
    try:
        with interruptible(), monitor.stage("Refinement", _samples(lesson)) as progress:
            shown = parts.trainer.extended(TrainingProgress(progress, monitor.say), enable_progress_bar=False)
            outcome = refine(estimator, supervised, settings, folder, shown, plan.budget)
    except SlamError as error:
        monitor.say(f"  {error}")
        return None
    write_losses(outcome.losses, tuple(settings.loss), folder / "losses.csv")
    learnt = learn_sigma(estimator, supervised, outcome.held_out_frames) or {}
    _store_weights(parts, loop)
    return {**_figures(outcome, settings), **learnt}


def _store_weights(parts: LoopParts, loop: int) -> None:
    with parts.store.new_folder(parts.store.loop(loop, "weights")) as weights:
        parts.estimator.save_weights(weights)


def _figures(outcome: RefinementOutcome, settings: RefinementSettings) -> dict[str, Any]:
    return {
        "held_out_before": outcome.held_out_before,
        "held_out_after": outcome.held_out_after,
        "samples": outcome.samples,
        "train_samples": outcome.train_samples,
        "held_out_samples": outcome.held_out_samples,
        "keyframes": outcome.keyframes,
        "skipped": sum(outcome.skipped.values()),
        "skipped_because": "; ".join(f"{count} with {why}" for why, count in outcome.skipped.items()) or None,
        "points_per_sample": outcome.points_per_sample,
        "steps": outcome.steps,
        "learning_rate": settings.learning_rate,
        "batch_size": settings.batch_size,
        "seconds": outcome.seconds,
    }


def _samples(lesson: Lesson) -> int:
    """Return how many samples a training sees; those of one pass where a time decides."""
    settings, budget = lesson.plan.settings, lesson.plan.budget
    keyframes = sum(len(result.keyframes) for _, result in lesson.supervised)
    if budget is None:
        return keyframes * int(settings.epochs)
    return keyframes if budget.steps is None else budget.steps * settings.samples_per_step


def write_losses(rows: list[dict[str, Any]], terms: tuple[str, ...], path: Path) -> None:
    """Write the losses of the training steps: ``step,epoch,total`` and a column per term, empty where not computed."""
    columns = ("step", "epoch", "total", *terms)
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in rows:
            if row.get("split", "train") == "train":
                writer.writerow([row.get(column, "") for column in columns])
