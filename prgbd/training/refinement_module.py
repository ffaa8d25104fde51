"""The Lightning module of depth refinement, and the callback that keeps its losses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import Callback
from torch import Tensor

from prgbd.core.depth import DepthEstimator
from prgbd.core.types import DepthPrediction
from prgbd.functional.losses import photometric_loss, smoothness_loss
from prgbd.functional.sparse_losses import depth_consistency, depth_transfer
from prgbd.functional.warping import invert_rigid
from prgbd.training.augmentation import augmented
from prgbd.training.batch_statistics import BATCH_NORMALISATION
from prgbd.training.optimizers import adam
from prgbd.training.refinement_data import RefinementBatch
from prgbd.training.refinement_settings import TERMS, RefinementSettings
from prgbd.training.sampling import step_seed


def points_at(batch: RefinementBatch, depth: Tensor, view: int | None) -> tuple[Tensor, Tensor]:
    """Return keypoints of a view, (B, N, 2), and intrinsics, (B, 3, 3), at the size of a depth map.

    The view None stands for the points of c that teach its own depth. A network's finest depth map need not have the
    size of its input.
    """
    uv = batch.seen_uv if view is None else batch.uv[:, view]
    height, width = depth.shape[-2:]
    size = batch.images.shape[-2:]
    if (height, width) == tuple(size):
        return uv, batch.K
    factor = batch.uv.new_tensor([width / size[1], height / size[0]])
    K = batch.K.clone()
    K[:, :2, :2] = K[:, :2, :2] * factor[:, None]
    K[:, :2, 2] = (K[:, :2, 2] + 0.5) * factor - 0.5
    return (uv + 0.5) * factor - 0.5, K


class DepthRefinement(lightning.LightningModule):
    """The training of any depth network on SLAM's output.

    Total loss: ``alpha P + beta S + gamma D + mu (T_{c,k1} + T_{c,k2} + T_{k1,k2})``. Sparse terms use the finest depth
    map; terms of weight 0 are not computed.

    Args:
        estimator: The network; it is trained in place.
        settings: Weights and all else.
    """

    def __init__(self, estimator: DepthEstimator, settings: RefinementSettings) -> None:
        super().__init__()
        self.estimator = estimator
        self.settings = settings
        self._random = torch.Generator()

    def train(self, mode: bool = True) -> DepthRefinement:
        """Switch to training mode; batch normalisation stays in evaluation mode where that was asked for."""
        super().train(mode)
        if mode and self.settings.freeze_batchnorm:
            for module in self.modules():
                if isinstance(module, BATCH_NORMALISATION):
                    module.eval()
        return self

    def terms(
        self, batch: RefinementBatch, generator: torch.Generator | None, seen: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Compute the unweighted terms of a batch.

        Args:
            batch: Float images.
            generator: Noise of the automatic mask, on the device of the batch.
            seen: (B, 5, 3, H, W) what the network sees, if not the images themselves.

        Returns:
            Term -> scalar, for the terms with a weight.
        """
        weights = self.settings.weights
        seen = batch.images if seen is None else seen
        views = [0, 3, 4] if weights["depth_transfer"] else [0]
        inputs = torch.cat([seen[:, view] for view in views])
        if self.settings.channels_last:
            inputs = inputs.contiguous(memory_format=torch.channels_last)
        prediction: DepthPrediction = self.estimator(inputs)
        size = batch.images.shape[0]
        current = DepthPrediction(
            tuple(d[:size] for d in prediction.depths),
            None if prediction.disparities is None else tuple(d[:size] for d in prediction.disparities),
        )
        target = batch.images[:, 0]
        out: dict[str, Tensor] = {}
        if weights["photometric"]:
            sources, sTt = [batch.images[:, 1], batch.images[:, 2]], [batch.aTc[:, 0], batch.aTc[:, 1]]
            out["photometric"] = photometric_loss(
                current, target, sources, batch.K, sTt, self.settings.automask, generator
            )
        if weights["smoothness"]:
            out["smoothness"] = smoothness_loss(current, target)
        with torch.autocast(target.device.type, enabled=False):
            if weights["depth_consistency"]:
                out["depth_consistency"] = depth_consistency(
                    current.depth.float(),
                    points_at(batch, current.depth, None)[0],
                    batch.seen_depth,
                    batch.seen_mask,
                    residual=self.settings.residual,
                )
            if weights["depth_transfer"]:
                out["depth_transfer"] = self._transfer(batch, prediction.depth.float())
        return out

    def _transfer(self, batch: RefinementBatch, depth: Tensor) -> Tensor:
        """T_{c,k1} + T_{c,k2} + T_{k1,k2}; ``depth`` holds the maps of c, k1 and k2 one after the other."""
        depths = depth.chunk(3)
        points = [points_at(batch, d, view) for view, d in enumerate(depths)]
        eye = torch.eye(4, device=depth.device, dtype=batch.kTc.dtype).expand_as(batch.kTc[:, 0])
        vTc = [eye, batch.kTc[:, 0], batch.kTc[:, 1]]
        total = depth.new_zeros(())
        for a, b in ((0, 1), (0, 2), (1, 2)):
            total = total + depth_transfer(
                (depths[a], depths[b]),
                (points[a][0], points[b][0]),
                points[a][1],
                vTc[b] @ invert_rigid(vTc[a]),
                batch.mask,
                patch=self.settings.patch,
                matching=self.settings.matching,
                reduction=self.settings.reduction,
                residual=self.settings.residual,
                anchors=(batch.depth[:, a], batch.depth[:, b]) if self.settings.anchored_transfer else None,
            )
        return total / 3 if self.settings.reduction == "average" else total

    def total(self, terms: Mapping[str, Tensor]) -> Tensor:
        """Weigh and add the terms."""
        return torch.stack([self.settings.weights[name] * value for name, value in terms.items()]).sum()

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
        seen = None
        if self.settings.augment:
            batch, seen = augmented(batch, self._random)
        terms = self.terms(batch, noise, seen)
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
        return adam(self, self.estimator.parameters(), self.settings.learning_rate)


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
        row |= {name: float(values[name]) for name in ("total", *TERMS) if name in values}
        self.rows.append(row)
