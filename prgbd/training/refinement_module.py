"""The Lightning module of depth refinement, and the callback that keeps its losses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import Callback
from torch import Tensor, nn

from prgbd.core.depth import DepthEstimator
from prgbd.core.depth_kind import DepthKind
from prgbd.core.loss import LossInputs
from prgbd.core.refinement_batch import RefinementBatch
from prgbd.core.types import DepthPrediction
from prgbd.training.alignment import aligned
from prgbd.training.batch_statistics import BATCH_NORMALISATION
from prgbd.training.objective import make_augmentations, make_terms
from prgbd.training.optimizers import adam
from prgbd.training.refinement_settings import RefinementSettings
from prgbd.training.sampling import step_seed


class DepthRefinement(lightning.LightningModule):
    """The training of any depth network on SLAM's output.

    The total loss is the weighted sum of the terms that the settings name. The network predicts the depth of those
    images alone that a term asks for. Where its inverse depth lacks scale and shift, SLAM's points give both to every
    image before the terms see it.

    Args:
        estimator: The network; it is trained in place.
        settings: Loss terms, augmentations and all else.
    """

    def __init__(self, estimator: DepthEstimator, settings: RefinementSettings) -> None:
        super().__init__()
        self.estimator = estimator
        self.settings = settings
        terms = make_terms(settings.loss)
        self._names = tuple(terms)
        self._weights = {name: float(term.weight) for name, term in terms.items()}
        self._terms = nn.ModuleList(terms.values())
        self._views = tuple(sorted({view for term in terms.values() for view in term.views}))
        self._augmentations = make_augmentations(settings.augmentation, settings.augment)
        self._random = torch.Generator()

    def train(self, mode: bool = True) -> DepthRefinement:
        """Switch to training mode; batch normalisation stays in evaluation mode where that was asked for."""
        super().train(mode)
        if mode and self.settings.freeze_batchnorm:
            for module in self.modules():
                if isinstance(module, BATCH_NORMALISATION):
                    module.eval()
        return self

    def terms(self, batch: RefinementBatch, generator: torch.Generator | None) -> dict[str, Tensor]:
        """Compute the unweighted terms of a batch, in float32 even under mixed precision.

        Args:
            batch: Float images.
            generator: Random numbers of the terms, on the device of the batch.

        Returns:
            Name -> scalar, for the terms with a weight.
        """
        images = torch.cat([batch.inputs[:, view] for view in self._views])
        if self.settings.channels_last:
            images = images.contiguous(memory_format=torch.channels_last)
        prediction: DepthPrediction = self.estimator(images)
        disparities, sigma = prediction.disparities, prediction.sigma
        prediction = DepthPrediction(
            tuple(depth.float() for depth in prediction.depths),
            None if disparities is None else tuple(disparity.float() for disparity in disparities),
            None if sigma is None else sigma.float(),
        )
        with torch.autocast(batch.images.device.type, enabled=False):
            if self.estimator.depth_kind == DepthKind.AFFINE_DISPARITY:
                prediction = aligned(prediction, batch, self._views)
            inputs = LossInputs(batch, self._views, prediction, generator)
            return {name: term(inputs) for name, term in zip(self._names, self._terms, strict=True)}

    def total(self, terms: Mapping[str, Tensor]) -> Tensor:
        """Weigh and add the terms."""
        return torch.stack([self._weights[name] * value for name, value in terms.items()]).sum()

    def on_after_batch_transfer(self, batch: RefinementBatch, dataloader_idx: int) -> RefinementBatch:
        """Turn bytes into [0, 1] on the device."""
        return batch._replace(images=batch.images.float() / 255)

    def training_step(self, batch: RefinementBatch, batch_idx: int) -> dict[str, Any]:
        """Compute and log the loss of a batch."""
        # Whatever is drawn in a step depends on its number alone, so that a training that was stopped can go on.
        seed = step_seed(self.settings.seed, self.current_epoch, self.global_rank, batch_idx + 1)
        torch.manual_seed(seed)  # for networks that draw themselves, such as dropout
        self._random.manual_seed(seed)
        noise = torch.Generator(batch.images.device).manual_seed(seed)
        for augmentation in self._augmentations:
            batch = augmentation(batch, self._random)
        terms = self.terms(batch, noise)
        total = self.total(terms)
        self._log("train", total, terms, batch, prog_bar=True)
        return {"loss": total, "terms": {name: value.detach() for name, value in terms.items()}}

    def validation_step(self, batch: RefinementBatch, batch_idx: int) -> None:
        """Log the loss of held-out keyframes; the noise is the same every time."""
        noise = torch.Generator(batch.images.device).manual_seed(self.settings.seed + 1 + batch_idx)
        terms = self.terms(batch, noise)
        self._log("held_out", self.total(terms), terms, batch, on_step=False, on_epoch=True, sync_dist=True)

    def _log(self, split: str, total: Tensor, terms: Mapping[str, Tensor], batch: RefinementBatch, **how: Any) -> None:
        values = {f"{split}/total": total} | {f"{split}/{name}": value for name, value in terms.items()}
        self.log_dict(values, batch_size=batch.images.shape[0], **how)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Adam, as in pre-training."""
        return adam(self, self.estimator.parameters(), self.settings.step_size)


class LossRows(Callback):
    """Keeps the losses as rows for reports.

    Attributes:
        rows: See ``RefinementOutcome.losses``.
    """

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []

    def on_train_batch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Keep the losses of a step."""
        self._add("train", trainer, {"total": outputs["loss"], **outputs["terms"]})

    def on_validation_epoch_end(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule) -> None:
        """Keep the losses of a pass over the held-out keyframes."""
        values = {k.removeprefix("held_out/"): v for k, v in trainer.callback_metrics.items() if "held_out/" in k}
        self._add("held_out", trainer, values)

    def state_dict(self) -> dict[str, Any]:
        """Keep the rows in the checkpoint."""
        return {"rows": [dict(row) for row in self.rows]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over the rows of a training that was stopped."""
        self.rows = [dict(row) for row in state_dict["rows"]]

    handed_over, take_over = state_dict, load_state_dict

    def _add(self, split: str, trainer: lightning.Trainer, values: Mapping[str, Any]) -> None:
        row: dict[str, Any] = {"split": split, "epoch": trainer.current_epoch, "step": trainer.global_step}
        row |= {name: float(value) for name, value in values.items()}
        self.rows.append(row)
