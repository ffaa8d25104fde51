"""Files of tensors that are equal byte by byte where the tensors are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch


def write_tensors(entries: Mapping[str, Any], path: Path) -> None:
    """Write entries as ``torch.load`` reads them.

    ``torch.save`` writes the file's own name into the file when it is given a path, and files that are written whole or
    not at all have a temporary name of their own each time.

    Args:
        entries: Name -> tensor or plain value.
        path: The file.
    """
    with open(path, "wb") as file:
        torch.save(dict(entries), file)
