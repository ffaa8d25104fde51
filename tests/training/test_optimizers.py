"""The fused optimiser: the plain one's results, and out of the way of what it cannot do."""

from __future__ import annotations

import lightning
import pytest
import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import nn
from torch.utils.data import DataLoader

from prgbd.training.optimizers import adam


class Line(lightning.LightningModule):
    """A convolution in the layout that training uses."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.layer = nn.Conv2d(3, 4, 3).to(memory_format=torch.channels_last)
        self.frozen = nn.Parameter(torch.zeros(1), requires_grad=False)

    def training_step(self, batch: torch.Tensor, batch_idx: int) -> torch.Tensor:
        return self.layer(batch).square().mean()

    def configure_optimizers(self) -> OptimizerLRScheduler:
        return adam(self, self.parameters(), 1e-2)


def test_steps_as_plain_adam_and_leaves_frozen_parameters_out():
    module, plain = Line(), Line()
    fused = adam(module, module.parameters(), 1e-2)
    assert fused.defaults["fused"]
    assert len(fused.param_groups[0]["params"]) == 2
    reference = torch.optim.Adam(plain.layer.parameters(), lr=1e-2)
    for step in range(5):
        images = torch.rand(2, 3, 8, 8, generator=torch.Generator().manual_seed(step))
        for network, optimizer in ((module, fused), (plain, reference)):
            optimizer.zero_grad()
            network.training_step(images, 0).backward()
            optimizer.step()
    torch.testing.assert_close(module.layer.weight, plain.layer.weight, rtol=1e-4, atol=1e-5)
    assert not torch.equal(module.layer.weight, Line().layer.weight)


@pytest.mark.parametrize("precision", ["32-true", "bf16-mixed"])
def test_gradients_can_be_clipped(tmp_path, precision):
    module = Line()
    trainer = lightning.Trainer(
        accelerator="cpu",
        devices=1,
        max_epochs=1,
        precision=precision,
        gradient_clip_val=0.5,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        default_root_dir=tmp_path,
    )
    trainer.fit(module, DataLoader(torch.rand(4, 3, 8, 8), batch_size=2))
    assert trainer.global_step == 2
    assert not trainer.optimizers[0].defaults["fused"]
