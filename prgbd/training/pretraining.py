"""Self-supervised pre-training of a depth network with its pose network, as Monodepth2 does it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping
from collections.abc import Sequence as Many
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.utilities.seed import isolate_rng
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from rich.progress import track
from torch import Tensor, nn

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.errors import ConfigError
from prgbd.functional.colour import jittered
from prgbd.functional.losses import photometric_loss, smoothness_loss
from prgbd.functional.warping import invert_rigid
from prgbd.training.checkpoints import Handover, StepCheckpoint, tensors_by_name
from prgbd.training.images import image_folder
from prgbd.training.optimizers import adam
from prgbd.training.pretraining_data import DecodedSequence, PretrainingData, Triplets, decode
from prgbd.training.pretraining_settings import PretrainingSettings
from prgbd.training.quiet import quiet_lightning
from prgbd.training.sampling import step_seed
from prgbd.training.trainers import TrainerFactory


class DepthPretraining(lightning.LightningModule):
    """Photometric training of a depth and a pose network on triplets of frames (Godard et al., ICCV 2019).

    Warps take the plain images, the networks the augmented ones.

    Args:
        estimator: The depth network; it is trained in place.
        pose: Its pose network, called as ``pose(first, second)``, see ``DepthEstimator.pose_network``.
        settings: All options.

    Attributes:
        held_out_before: Loss on the held-out triplets before training; a training that goes on finds it in its
            checkpoint.
        epochs: Number of passes that were begun; kept in the checkpoint as well.
        steps: Number of steps of the optimiser.
    """

    def __init__(self, estimator: DepthEstimator, pose: nn.Module, settings: PretrainingSettings) -> None:
        super().__init__()
        self.estimator = estimator
        self.pose = pose
        self.settings = settings
        self.held_out_before: float | None = None
        self.epochs = 0
        self.steps = 0
        self._random = torch.Generator()

    def on_train_epoch_start(self) -> None:
        """Count."""
        self.epochs = self.current_epoch + 1

    def handed_over(self) -> dict[str, Any]:
        """Return the figures that the module of a spawned process holds."""
        return {"epochs": self.epochs, "steps": int(self.trainer.global_step)}

    def take_over(self, figures: Mapping[str, Any]) -> None:
        """Take over those figures."""
        self.epochs, self.steps = figures["epochs"], figures["steps"]

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the figures that a training that goes on would not find out again."""
        checkpoint["pretraining"] = {"held_out_before": self.held_out_before, "epochs": self.epochs}

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Take over those figures."""
        figures = checkpoint["pretraining"]
        self.held_out_before, self.epochs = figures["held_out_before"], figures["epochs"]

    def on_after_batch_transfer(self, batch: Triplets, dataloader_idx: int) -> Triplets:
        """Turn bytes into [0, 1] on the device."""
        return batch._replace(images=batch.images.float() / 255)

    def loss(self, batch: Triplets, seen: Tensor, generator: torch.Generator | None) -> dict[str, Tensor]:
        """Compute the total loss and its terms.

        Args:
            batch: Float images that the warps take.
            seen: (B, 3, 3, H, W) what the networks see.
            generator: Noise of the automatic mask.

        Returns:
            ``total``, ``photometric`` and ``smoothness``.
        """
        target, earlier, later = seen.unbind(dim=1)
        if self.settings.channels_last:
            target = target.contiguous(memory_format=torch.channels_last)
        prediction = self.estimator(target)
        # The pose network sees pairs in temporal order; the motion to the earlier frame is the inverse.
        sTt = [invert_rigid(self.pose(earlier, target).float()), self.pose(target, later).float()]
        plain = batch.images.unbind(dim=1)
        photometric = photometric_loss(
            prediction, plain[0], plain[1:], batch.K, sTt, automask=self.settings.automask, generator=generator
        )
        smooth = smoothness_loss(prediction, plain[0])
        total = photometric + self.settings.smoothness * smooth
        return {"total": total, "photometric": photometric, "smoothness": smooth}

    def training_step(self, batch: Triplets, batch_idx: int) -> Tensor:
        """Compute and log the loss of a batch."""
        # Whatever is drawn in a step depends on its number alone, so that a training that was stopped can go on.
        seed = step_seed(self.settings.seed, self.current_epoch, self.global_rank, batch_idx + 1)
        torch.manual_seed(seed)  # for networks that draw themselves, such as dropout
        self._random.manual_seed(seed)
        noise = torch.Generator(batch.images.device).manual_seed(seed)
        seen = batch.images
        if self.settings.augment:
            batch, seen = augmented(batch, self._random)
        values = self.loss(batch, seen, noise)
        self._log("train", values, batch, prog_bar=True)
        return values["total"]

    def validation_step(self, batch: Triplets, batch_idx: int) -> None:
        """Log the loss of held-out triplets; the noise is the same every time."""
        noise = torch.Generator(batch.images.device).manual_seed(self.settings.seed + 1 + batch_idx)
        self._log(
            "held_out", self.loss(batch, batch.images, noise), batch, on_step=False, on_epoch=True, sync_dist=True
        )

    def _log(self, split: str, values: Mapping[str, Tensor], batch: Triplets, **how: Any) -> None:
        named = {f"{split}/{name}": value.detach() for name, value in values.items()}
        self.log_dict(named, batch_size=batch.images.shape[0], **how)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam over both networks, with a step down of the learning rate."""
        optimizer = adam(self, self.parameters(), self.settings.learning_rate)
        return {
            "optimizer": optimizer,
            "lr_scheduler": torch.optim.lr_scheduler.StepLR(optimizer, self.settings.lr_step_epoch, 0.1),
        }


def augmented(batch: Triplets, generator: torch.Generator) -> tuple[Triplets, Tensor]:
    """Mirror half of the triplets, with their cameras, and jitter the colours of half of them.

    Args:
        batch: Float images.
        generator: Random numbers, on the CPU.

    Returns:
        The mirrored batch, whose images the warps take, and the jittered images that the networks see.
    """
    flips, jitters = (torch.rand(2, batch.images.shape[0], generator=generator) < 0.5).to(batch.images.device)
    images = torch.where(flips[:, None, None, None, None], batch.images.flip(-1), batch.images)
    K = batch.K.clone()
    K[:, 0, 2] = torch.where(flips, images.shape[-1] - 1 - K[:, 0, 2], K[:, 0, 2])
    return Triplets(images, K), jittered(images, jitters, generator)


def pretrain(
    estimator: DepthEstimator,
    sequences: Many[Sequence],
    settings: PretrainingSettings,
    out: Path,
    trainer: TrainerFactory | None = None,
) -> dict[str, Any]:
    """Train a depth network and its pose network on unlabelled recordings, each with its own intrinsics.

    The networks are trained in place; the caller saves their weights.

    Args:
        estimator: The depth network; it must bring a pose network.
        sequences: The recordings.
        settings: All options.
        out: Folder for the checkpoint that a killed training goes on from, and for images that do not fit into memory.
        trainer: The Lightning configuration (accelerator, devices, precision, callbacks, ...).

    Returns:
        ``steps``, ``epochs``, ``train_samples``, ``held_out_samples``, ``still_frames`` per recording,
        ``held_out_before`` and ``held_out_after`` (total loss on held-out triplets), and ``seconds``.

    Raises:
        ConfigError: If the network brings no pose network, or Lightning refuses its configuration.
        DataError: If no frame moves, or an image cannot be read.
    """
    began = time.perf_counter()
    pose = estimator.pose_network()
    if pose is None:
        raise ConfigError(
            f"{type(estimator).__name__} brings no pose network, which self-supervised pre-training needs; choose "
            "depth=monodepth2 or implement pose_network()."
        )
    factory = trainer or TrainerFactory()
    was_training = estimator.training
    with _decoded(estimator, sequences, settings, out, factory.bar) as sources, isolate_rng(), quiet_lightning():
        data = PretrainingData(sources, settings)
        lightning.seed_everything(settings.seed, workers=True, verbose=False)
        module = DepthPretraining(estimator, pose, settings)
        if settings.channels_last:
            module.to(memory_format=torch.channels_last)
        checkpoint = StepCheckpoint(out / "checkpoint", settings.checkpoint_minutes)
        handover = Handover(out, module)
        defaults = {"max_epochs": settings.epochs, "max_steps": settings.max_steps, "log_every_n_steps": 10}
        fitting, gauge = factory.pair(out, defaults, [checkpoint, handover], compiled=settings.compile)
        resumed = checkpoint.resumable()
        if resumed is None:
            module.held_out_before = gauge.validate(module, datamodule=data, verbose=False)[0]["held_out/total"]
        module.train()
        with tensors_by_name():
            fitting.fit(module, datamodule=data, ckpt_path=resumed, weights_only=True)
        module.steps = int(fitting.global_step)
        handover.collect()
        after = gauge.validate(module, datamodule=data, verbose=False)[0]["held_out/total"]
    estimator.train(was_training)
    shutil.rmtree(out / "checkpoint", ignore_errors=True)
    return {
        "steps": module.steps,
        "epochs": module.epochs,
        "train_samples": data.train_samples,
        "held_out_samples": data.held_out_samples,
        "still_frames": {source.name: source.still for source in sources},
        "held_out_before": module.held_out_before,
        "held_out_after": float(after),
        "seconds": time.perf_counter() - began,
    }


@contextmanager
def _decoded(
    estimator: DepthEstimator, sequences: Many[Sequence], settings: PretrainingSettings, out: Path, bar: bool
) -> Iterator[list[DecodedSequence]]:
    """Decode all images once; what does not fit into memory lies in a folder that goes at the end."""
    folder = image_folder(sum(map(len, sequences)), estimator.input_size, settings.memory_mb, out)
    try:
        yield [
            decode(sequence, estimator, settings, folder / f"{number}.npy" if folder else None)
            for number, sequence in enumerate(track(list(sequences), "Decoding", transient=True, disable=not bar))
        ]
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
