"""The Lightning trainer that pre-training and refinement share."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence as Many
from pathlib import Path
from typing import Any

import lightning
from lightning.pytorch.callbacks import Callback, RichProgressBar

from prgbd.training.compile_callback import Compilation


def make_trainer(
    out: Path,
    options: Mapping[str, Any],
    defaults: Mapping[str, Any],
    *,
    callbacks: Many[Callback],
    compiled: bool,
    bar: bool,
    logger: Any,
) -> lightning.Trainer:
    """Make a trainer with the user's options.

    Args:
        out: Folder of what Lightning writes.
        options: The user's options of ``lightning.Trainer``.
        defaults: Options that hold unless the user gives them.
        callbacks: Callbacks beside the user's.
        compiled: Whether the module is compiled by torch.compile.
        bar: Whether a progress bar is shown.
        logger: A Lightning logger, several, or None.
    """
    given = {name: value for name, value in options.items() if name not in ("callbacks", "enable_progress_bar")}
    several: list[Callback] = [*options.get("callbacks", []), *callbacks]
    if compiled:
        several.append(Compilation())
    if bar:
        several.append(RichProgressBar(leave=False))
    everywhere: dict[str, Any] = {
        "accelerator": "cpu",
        "devices": 1,
        "default_root_dir": out,
        "num_sanity_val_steps": 0,
        "enable_model_summary": False,
        "use_distributed_sampler": False,  # the samplers share out the samples themselves
    }
    return lightning.Trainer(
        **(everywhere | dict(defaults) | given),
        callbacks=several,
        logger=logger if logger is not None else False,
        enable_progress_bar=bar,
    )
