"""Depth refinement: a depth network learns from SLAM's poses, keyframes and points (Tiwari et al., ECCV 2020)."""

from __future__ import annotations

import hashlib
import math
import shutil
import time
from collections import Counter
from collections.abc import Iterator
from collections.abc import Sequence as Many
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.utilities.seed import isolate_rng

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator, weights_fingerprint
from prgbd.core.errors import SlamError
from prgbd.core.types import SlamResult
from prgbd.functional.sparse_losses import sample_patches
from prgbd.training.batch_statistics import measure_batch_statistics
from prgbd.training.budget import Budget
from prgbd.training.checkpoints import Handover, StepCheckpoint, tensors_by_name
from prgbd.training.images import image_folder
from prgbd.training.learning_plan import LearningPlan, learning_plan
from prgbd.training.quiet import quiet_lightning
from prgbd.training.refinement_data import (
    RefinementData,
    SupervisedImages,
    decode_images,
    needed_frames,
)
from prgbd.training.refinement_module import DepthRefinement, LossRows
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.supervision import Supervision, keyframe_samples
from prgbd.training.timed_steps import TimedSteps
from prgbd.training.trainers import TrainerFactory

_SCALE_SAMPLES = 16


@dataclass(frozen=True)
class RefinementOutcome:
    """What a refinement did.

    Attributes:
        losses: One row per training step and per pass over the held-out keyframes: ``split`` (``train`` or
            ``held_out``), ``epoch``, ``step``, ``total`` and the unweighted value of every computed term.
        held_out_before: Total loss on the held-out keyframes before training, the label-free criterion.
        held_out_after: The same after training, on the same supervision and with the same noise.
        samples: Number of keyframes that gave a sample.
        train_samples: How many of them trained.
        held_out_samples: How many of them measured the criterion.
        keyframes: Number of keyframes that SLAM kept.
        skipped: Why the others gave none, reason -> number.
        points_per_sample: Mean number of points that a sample's three keyframes share.
        held_out_frames: Recording and frame of the keyframes that measured the criterion.
        scales: Factor on SLAM's lengths per sequence, that of its largest map; 1 where the scale was left alone.
        steps: Steps of the optimiser.
        seconds: Duration.
    """

    losses: list[dict[str, Any]]
    held_out_before: float
    held_out_after: float
    samples: int
    train_samples: int
    held_out_samples: int
    keyframes: int
    skipped: dict[str, int]
    points_per_sample: float
    held_out_frames: list[tuple[str, int]] = field(default_factory=list)
    scales: dict[str, float] = field(default_factory=dict)
    steps: int = 0
    seconds: float = 0.0


def refine(
    estimator: DepthEstimator,
    supervised: Many[tuple[Sequence, SlamResult]],
    settings: RefinementSettings,
    out: Path,
    trainer: TrainerFactory | None = None,
    budget: Budget | None = None,
) -> RefinementOutcome:
    """Fine-tune a depth network on what SLAM found out about one or several sequences.

    The network is trained in place. A refinement that was killed goes on from the checkpoint that it left in ``out``,
    if it started from the same weights, supervision and options. Same seed, same machine, same result, killed or not;
    the caller's random state is left alone.

    Args:
        estimator: The network.
        supervised: Recordings and what SLAM made of them.
        settings: All options of the refinement.
        out: Folder for images that do not fit into memory, and for the checkpoint that a killed refinement goes on
            from.
        trainer: The Lightning configuration (accelerator, devices, precision, callbacks, ...).
        budget: When the training ends, where ``settings.epochs`` is "auto"; None: by the number of keyframes.

    Returns:
        Losses, the label-free criterion before and after, and what became of the keyframes.

    Raises:
        ConfigError: If Lightning refuses its configuration.
        SlamError: If no keyframe of any sequence can supervise depth.
        DataError: If an image cannot be read, or SLAM saw images of another size.
    """
    began = time.perf_counter()
    supervisions = [_supervision(result, settings) for _, result in supervised]
    _require_samples(supervised, supervisions)
    plan = learning_plan(settings, sum(len(s.samples) for s in supervisions), budget)
    settings = plan.settings
    out.mkdir(parents=True, exist_ok=True)
    was_training = estimator.training
    with _decoded(estimator, supervised, supervisions, settings, out) as sources, quiet_lightning(), isolate_rng():
        lightning.seed_everything(settings.seed, workers=True, verbose=False)
        data = RefinementData(sources, settings)
        key = _key(estimator, plan, sources)
        rows = _fit(DepthRefinement(estimator, settings), data, out, trainer or TrainerFactory(), plan.budget, key)
    estimator.train(was_training)
    held_out = [row for row in rows if row["split"] == "held_out"]
    return RefinementOutcome(
        losses=rows,
        held_out_before=held_out[0]["total"],
        held_out_after=held_out[-1]["total"],
        samples=sum(len(s.samples) for s in supervisions),
        train_samples=data.train_samples,
        held_out_samples=data.held_out_samples,
        keyframes=sum(s.keyframes for s in supervisions),
        skipped=dict(sum((Counter(s.skipped) for s in supervisions), Counter())),
        points_per_sample=float(np.mean([len(x.point) for s in supervisions for x in s.samples])),
        held_out_frames=data.held_out_frames,
        scales=_scales(sources),
        steps=max(row["step"] for row in rows),
        seconds=time.perf_counter() - began,
    )


def _scales(sources: list[SupervisedImages]) -> dict[str, float]:
    ascending = sorted(sources, key=lambda source: len(source.supervision.samples))
    return {source.name: source.scale for source in ascending}


def _fit(
    module: DepthRefinement, data: RefinementData, out: Path, factory: TrainerFactory, budget: Budget | None, key: str
) -> list[dict[str, Any]]:
    """Measure the criterion, train, measure it again; return the rows of losses."""
    settings, rows = module.settings, LossRows()
    checkpoint = StepCheckpoint(out / "checkpoint", settings.checkpoint_minutes, epochs=settings.checkpoint, key=key)
    handover = Handover(out, rows)
    ends: dict[str, Any] = {"max_epochs": settings.epochs}
    timed: list[Callback] = []
    if budget is not None:
        ends = {"max_epochs": -1, "max_steps": budget.steps or -1}
        timed = [TimedSteps(budget.seconds, out, key)] if budget.seconds else []
    defaults = {**ends, "log_every_n_steps": 1}
    trainer, gauge = factory.pair(
        out, defaults, [rows, *timed, checkpoint, handover], measuring=[rows], compiled=settings.compile
    )
    resumed = checkpoint.resumable()
    if resumed is None:
        gauge.validate(module, datamodule=data, verbose=False)
    module.train()  # Lightning trains in the mode that it finds
    with tensors_by_name():
        trainer.fit(module, datamodule=data, ckpt_path=resumed, weights_only=True)
    handover.collect()
    measured = settings.measure_batchnorm and not settings.freeze_batchnorm and _measure_statistics(module, data, gauge)
    if measured or rows.rows[-1]["split"] != "held_out":
        last = rows.rows[-1]
        gauge.validate(module, datamodule=data, verbose=False)
        rows.rows[-1] |= {"epoch": last["epoch"], "step": last["step"]}
    if not settings.checkpoint:
        shutil.rmtree(out / "checkpoint", ignore_errors=True)
    return rows.rows


def _measure_statistics(module: DepthRefinement, data: RefinementData, trainer: lightning.Trainer) -> bool:
    """Measure the statistics of batch normalisation on the keyframes; say whether there are any."""
    home = next((p.device for p in module.parameters()), torch.device("cpu"))
    device = trainer.strategy.root_device
    module.to(device)
    try:
        return measure_batch_statistics(module.estimator, (images.to(device) for images in data.mixed_keyframes())) > 0
    finally:
        module.to(home)


def _key(estimator: DepthEstimator, plan: LearningPlan, sources: Many[SupervisedImages]) -> str:
    """Say in one word what a refinement starts from: weights, supervision and the options that decide the result."""
    digest = hashlib.sha256(weights_fingerprint(estimator).encode())
    for source in sources:
        digest.update(f"{source.name} {source.scale!r} {len(source.supervision.samples)}".encode())
        for sample in source.supervision.samples:
            digest.update(sample.frames.tobytes() + sample.aTc.tobytes() + sample.depth.tobytes())
    neutral = replace(plan.settings, checkpoint=False, checkpoint_minutes=0.0, workers=0, memory_mb=0)
    digest.update(repr((neutral, plan.budget)).encode())
    return digest.hexdigest()


def _supervision(result: SlamResult, settings: RefinementSettings) -> Supervision:
    return keyframe_samples(
        result,
        min_keyframes=settings.min_keyframes,
        max_reprojection_error=settings.max_reprojection_error,
        keyframe_gap=settings.keyframe_gap,
        frame_gap=settings.frame_gap,
        min_common_points=settings.min_common_points,
        consistency_points=settings.consistency_points,
        min_parallax=settings.min_parallax,
        far_points=settings.far_points,
    )


def _require_samples(supervised: Many[tuple[Sequence, SlamResult]], supervisions: Many[Supervision]) -> None:
    if any(s.samples for s in supervisions):
        return
    names = ", ".join(f"'{sequence.name}'" for sequence, _ in supervised) or "no sequence"
    skipped: Counter[str] = sum((Counter(s.skipped) for s in supervisions), Counter())
    reasons = "; ".join(f"{number} with {reason}" for reason, number in skipped.items()) or "no keyframes at all"
    raise SlamError(
        f"SLAM on {names} gave no keyframe that could supervise depth ({reasons}); use a recording that is longer, or "
        "on which SLAM keeps track."
    )


@contextmanager
def _decoded(
    estimator: DepthEstimator,
    supervised: Many[tuple[Sequence, SlamResult]],
    supervisions: Many[Supervision],
    settings: RefinementSettings,
    out: Path,
) -> Iterator[list[SupervisedImages]]:
    """Decode all images once; what does not fit into memory lies in a folder that goes at the end."""
    needed = sum(len(needed_frames(s)) for s in supervisions)
    folder = image_folder(needed, estimator.input_size, settings.memory_mb, out)
    try:
        sources: list[SupervisedImages] = []
        for (sequence, result), whole in zip(supervised, supervisions, strict=True):
            aligned = settings.align_scale or (settings.align_scale is None and result.mode == "mono")
            # Every monocular map has a scale of its own.
            for supervision in whole.by_map() if aligned else [whole]:
                file = folder / f"{len(sources)}.npy" if folder and supervision.samples else None
                source = decode_images(sequence, supervision, estimator, file)
                sources.append(replace(source, scale=network_scale(estimator, source)) if aligned else source)
        yield sources
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def network_scale(estimator: DepthEstimator, source: SupervisedImages) -> float:
    """Return the median ratio of predicted depth to SLAM's depth at the points of up to 16 current keyframes.

    1 if there is no point to compare.
    """
    count = len(source.supervision.samples)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _SCALE_SAMPLES)).round().astype(int))
    device = next((p.device for p in estimator.parameters()), torch.device("cpu"))
    ratios = []
    was_training = estimator.training
    estimator.eval()
    with torch.inference_mode(), estimator.finest_scale():
        for index in chosen:
            sample = source.sample(int(index))
            depth = estimator(sample.images[:1].to(device).float() / 255).depth.float().cpu()
            uv = sample.at_size(*depth.shape[-2:]).uv[:1]
            predicted = sample_patches(depth, uv, 1)
            known = predicted.inside[0, :, 0] & (sample.depth[0] > 0)
            ratios.append(predicted.depth[0, known, 0] / sample.depth[0, known])
    estimator.train(was_training)
    ratio = torch.cat(ratios) if ratios else torch.zeros(0)
    scale = float(ratio.median()) if len(ratio) else 1.0
    return scale if math.isfinite(scale) and scale > 0 else 1.0
