"""Watching SLAM at work: frames, poses and map for a viewer, recorded or live, of any SLAM system."""

from __future__ import annotations

import importlib.util
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError
from prgbd.core.slam import GeometricSLAM, TrackingResult
from prgbd.core.types import Frame, SlamResult

RERUN_PORT = 9876
CHOICES = ("none", "rerun", "rerun_live")


class SlamViewer(Protocol):
    """Somebody who looks at every frame and at the map of one SLAM run."""

    def tracked(self, frame: Frame, tracked: TrackingResult, system: GeometricSLAM) -> None:
        """See what became of a frame; ``system.view()`` tells more, where the system does."""

    def finished(self, result: SlamResult) -> None:
        """See the final result."""

    def __enter__(self) -> SlamViewer: ...

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None
    ) -> None: ...


class SilentViewer:
    """Looks away."""

    def tracked(self, frame: Frame, tracked: TrackingResult, system: GeometricSLAM) -> None:
        """See ``SlamViewer.tracked``."""

    def finished(self, result: SlamResult) -> None:
        """See ``SlamViewer.finished``."""

    def __enter__(self) -> SilentViewer:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None
    ) -> None:
        pass


# Makes a viewer for a recording; the path is where it may keep a file, without suffix.
ViewerMaker = Callable[[Sequence, Path], SlamViewer]


def viewer_maker(choice: str) -> ViewerMaker | None:
    """Return what makes viewers, None for ``none``.

    Args:
        choice: ``none``, ``rerun`` (a recording, no screen needed) or ``rerun_live`` (opens rerun's viewer).

    Raises:
        ConfigError: If the choice is unknown, rerun is not installed, or there is neither a screen nor a viewer.
    """
    if choice not in CHOICES:
        raise ConfigError(f"viz={choice} is unknown; choose {', '.join(CHOICES)}.")
    if choice == "none":
        return None
    if importlib.util.find_spec("rerun") is None:
        raise ConfigError(f"viz={choice} needs rerun; pip install 'prgbd[viz]'.")
    if choice == "rerun_live" and not (_has_screen() or _viewer_listens()):
        raise ConfigError(
            "viz=rerun_live needs a screen, or a viewer of rerun that runs already; use viz=rerun for a recording."
        )

    def make(sequence: Sequence, path: Path) -> SlamViewer:
        from prgbd.loop.rerun_viewer import RerunViewer

        recording = path.with_name(f"{path.name}.rrd") if choice == "rerun" else None
        return RerunViewer(sequence.name, sequence.camera, recording)

    return make


def _has_screen() -> bool:
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _viewer_listens() -> bool:
    """Say whether somebody answers at rerun's port on this machine, for example through an SSH tunnel."""
    with socket.socket() as probe:
        probe.settimeout(0.5)
        return probe.connect_ex(("127.0.0.1", RERUN_PORT)) == 0
