"""Reading models of the Transformers library from a folder or the hub, with errors in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from prgbd.core.errors import WeightsError

PROCESSOR = "preprocessor_config.json"
WEIGHTS = "model.safetensors"


def load_model(source: str) -> tuple[nn.Module, dict[str, Any] | None]:
    """Return a depth model and the content of its ``preprocessor_config.json`` (None without one).

    Args:
        source: A folder with ``config.json`` and ``model.safetensors``, or a name on the hub.

    Raises:
        WeightsError: If there is no such model, or it estimates no depth.
    """
    from transformers import AutoConfig, AutoModelForDepthEstimation
    from transformers.utils import logging

    logging.disable_progress_bar()
    logging.set_verbosity_error()
    folder = Path(source).expanduser()
    if folder.is_dir() and not (folder / "config.json").is_file():
        raise WeightsError(f"{folder} has no config.json, so it holds no model of Transformers; check depth.model.")
    if folder.is_dir():
        source = str(folder)
    elif source.startswith((".", "/", "~")) or source.count("/") != 1:
        raise WeightsError(
            f"There is no folder {source}; set depth.model to a folder or a name on the hub, OWNER/NAME."
        )
    try:
        config = AutoConfig.from_pretrained(source)
        if type(config) not in AutoModelForDepthEstimation._model_mapping:
            raise WeightsError(
                f"{source} is a model of the architecture '{config.model_type}', which estimates no depth; choose a "
                "model for depth estimation."
            )
        model, info = AutoModelForDepthEstimation.from_pretrained(source, config=config, output_loading_info=True)
        absent = sorted(info["missing_keys"]) or sorted(map(str, info["mismatched_keys"]))
        if absent:
            raise WeightsError(
                f"The weights of {source} lack {len(absent)} tensors of its architecture (e.g. {absent[0]}), which "
                "would be random; fetch the model again."
            )
        return model.float(), _processor(source)
    except WeightsError:
        raise
    except Exception as error:  # the hub, the network, JSON and safetensors raise errors of their own
        reason = " ".join(str(error).split())[:160].rstrip(". ")
        raise WeightsError(
            f"The model {source} cannot be loaded ({type(error).__name__}: {reason}); check depth.model, and the "
            "connection if it is on the hub."
        ) from error


def _processor(source: str) -> dict[str, Any] | None:
    from transformers.utils import cached_file

    path = cached_file(
        source,
        PROCESSOR,
        _raise_exceptions_for_missing_entries=False,
        _raise_exceptions_for_connection_errors=False,
    )
    return None if path is None else dict(json.loads(Path(path).read_text(encoding="utf-8")))


def read_weights(folder: Path) -> tuple[dict[str, Tensor], Path]:
    """Return the weights that ``save_weights`` wrote into ``folder`` (or the file in it), and the file's path.

    Transformers stores some tensors under the names that they had when the model was published, so it has to read them.

    Raises:
        WeightsError: If the file is absent or unreadable.
    """
    path = folder / WEIGHTS if folder.is_dir() else folder
    if not path.is_file():
        raise WeightsError(f"There is no weight file {path}; check the option depth.weights.")
    return load_model(str(path.parent))[0].state_dict(), path
