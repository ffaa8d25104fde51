"""A word to the user while numba compiles."""

from __future__ import annotations

import logging
from pathlib import Path

from prgbd.plugins.slam.orb_gtsam.features import matching

log = logging.getLogger(__name__)


def announce_compilation() -> None:
    """Log a line if the compiled kernels are not in numba's cache yet."""
    kernel = matching._by_window
    if kernel.signatures:
        return
    folder = Path(getattr(kernel.stats, "cache_path", None) or Path(__file__).parent / "__pycache__")
    if not any(folder.glob("matching._by_window-*.nbc")):
        log.warning("Compiling the SLAM kernels once; this takes about a minute and is remembered.")
