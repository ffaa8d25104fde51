"""Watching SLAM at work: frames, poses and map for a viewer, recorded or live, of any SLAM system."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError
from prgbd.core.slam import GeometricSLAM, TrackingResult
from prgbd.core.types import Frame, SlamResult

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
        ConfigError: If the choice is unknown or rerun is not installed.
    """
    if choice not in CHOICES:
        raise ConfigError(f"viz={choice} is unknown; choose {', '.join(CHOICES)}.")
    if choice == "none":
        return None
    if importlib.util.find_spec("rerun") is None:
        raise ConfigError(f"viz={choice} needs rerun; pip install 'prgbd[viz]'.")

    def make(sequence: Sequence, path: Path) -> SlamViewer:
        from prgbd.loop.rerun_viewer import RerunViewer

        recording = path.with_name(f"{path.name}.rrd") if choice == "rerun" else None
        return RerunViewer(sequence.name, sequence.camera, recording)

    return make
