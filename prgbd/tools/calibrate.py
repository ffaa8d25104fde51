"""The camera of a video or a folder of images, estimated by COLMAP, as a file that ``data=`` takes."""

from __future__ import annotations

from pathlib import Path

from prgbd.core.data import Sequence
from prgbd.core.registry import REGISTRY
from prgbd.io.files import atomic_path
from prgbd.plugins.data.calibration import estimate_camera


def calibrate(recording: Path, out: str | None) -> int:
    """Estimate the camera of a recording, with progress, and write it where ``data=video`` or ``images`` look.

    Args:
        recording: A video or a folder of images.
        out: The camera file; None for the place beside the recording.

    Returns:
        The exit code, 0.

    Raises:
        PrgbdError: If the recording cannot be read, or its camera not be estimated.
    """
    from rich.console import Console
    from rich.progress import Progress

    kind = "images" if recording.is_dir() else "video"
    beside = recording / "camera.yaml" if kind == "images" else recording.with_suffix(".camera.yaml")
    file = beside if out is None else Path(out)
    # Any field of view does: images come out as they are.
    sequence: Sequence = REGISTRY.make("data", kind, root=str(recording), fov=60.0)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("Looking at the motion", total=None)
        estimate = estimate_camera(
            lambda index: sequence.frame(index).image,
            len(sequence),
            str(recording),
            lambda what, done, total: progress.update(task, description=what, completed=done, total=total),
        )
    with atomic_path(file) as temporary:
        temporary.write_text(estimate.to_yaml(recording.name), encoding="utf-8")
    print(f"{recording}: {estimate.words()}")
    print(f"Written to {file}" + (f"; data={kind} takes it by itself." if file == beside else f"; data.camera={file}"))
    return 0
