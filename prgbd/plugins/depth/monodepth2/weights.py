"""The weight files of Monodepth2: one file per part, with the input size beside the encoder's entries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import nn

from prgbd.core.depth import load_matching, read_state_dict, stored_size
from prgbd.core.errors import WeightsError
from prgbd.core.tensor_files import write_tensors
from prgbd.io.files import atomic_path

ENCODER, DEPTH, POSE_ENCODER, POSE = "encoder.pth", "depth.pth", "pose_encoder.pth", "pose.pth"
UNCERTAINTY = "uncertainty.pth"
"""prgbd's own, beside the published files."""
EXTRA = ("height", "width", "use_stereo")
DEMO = Path(__file__).parents[3] / "assets" / "monodepth2_demo"
"""Weights that ship with prgbd; the README in the folder says how they are made."""


def find_folder(weights: Path | str) -> Path:
    """Return the folder of weight files that the option ``weights`` names; ``demo`` is the one that ships with prgbd.

    Raises:
        WeightsError: If there is no such folder, or it lacks a file.
    """
    folder = DEMO if str(weights) == "demo" else Path(weights)
    if folder.is_file():
        folder = folder.parent
    if not folder.is_dir():
        raise WeightsError(f"There is no folder {folder}; point depth.weights to a folder with {ENCODER} and {DEPTH}.")
    for name in (ENCODER, DEPTH):
        if not (folder / name).is_file():
            raise WeightsError(
                f"The folder {folder} has no {name}; point depth.weights to a folder with {ENCODER} and {DEPTH}."
            )
    return folder


def read_encoder(folder: Path) -> tuple[dict[str, Any], tuple[int, int] | None]:
    """Read the encoder's entries, and the (height, width) it was trained with where the file says so."""
    state = read_state_dict(folder / ENCODER)
    extra = {name: state.pop(name) for name in EXTRA if name in state}
    return state, stored_size(extra, folder / ENCODER)


def load_part(module: nn.Module, state: Mapping[str, Any], path: Path) -> None:
    """Load entries in any floating precision into a part of the network; the unused ``fc`` may be absent.

    Raises:
        WeightsError: If they are made for another network.
    """
    own = module.state_dict()
    merged = {name: value for name, value in own.items() if name.startswith("encoder.fc.")}
    load_matching(module, {**merged, **state}, path)


def write_part(module: nn.Module, path: Path, *, half: bool, extra: Mapping[str, Any] | None = None) -> None:
    """Write the entries of a part, whole or not at all.

    Args:
        module: The part.
        path: The file.
        half: Store floating-point entries as float16, half the size; they are read back as float32.
        extra: Further entries (plain numbers).
    """
    state: dict[str, Any] = {}
    for name, value in module.state_dict().items():
        value = value.detach().cpu().contiguous()
        state[name] = value.half() if half and value.is_floating_point() else value
    with atomic_path(path) as temporary:
        write_tensors({**state, **(extra or {})}, temporary)
