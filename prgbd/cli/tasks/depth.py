"""``task=depth``: the network's depth of every frame as pictures and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.cli.job import Job
from prgbd.cli.task_options import DepthTask
from prgbd.cli.tasks.reporting import report
from prgbd.core.data import Sequence
from prgbd.core.depth_kind import DepthKind
from prgbd.io.disk import writing
from prgbd.io.files import write_json
from prgbd.loop.depth_figures import depth_figures, write_samples
from prgbd.loop.outcome import Failures
from prgbd.loop.sensing import DepthSensor
from prgbd.loop.summary import write_summary
from prgbd.loop.uncertainty_figures import describe_uncertainty, uncertainty_figures

_PNG_MAX = 65535
_UNITS = {
    DepthKind.METRIC: "m",
    DepthKind.SCALE: "up to scale",
    DepthKind.AFFINE_DISPARITY: "inverse depth up to scale and shift",
}


def run(job: Job) -> None:
    """Write the depth of every sequence, and its figures where there is truth."""
    sequences = [*job.parts.sequences, *job.parts.test_sequences]
    sensors = [make_sensor(job, sequence) for sequence in sequences]
    written = {}
    failures = Failures(len(sensors), job.display)
    for sensor in sensors:
        name = sensor.sequence.name
        with failures.of(name):
            written[name] = job.store.step(f"depth/{name}", partial(_write_depth, job, sensor))
            folder = job.shown(job.store.path("depth", name))
            job.display.say(f"  {name}: {written[name]['frames']} depth maps in {folder}")
    if job.store.is_done("recordings") and job.store.result("recordings") != list(written):
        job.store.forget("loops/00/depth", "loops/00/uncertainty")  # one that failed before is there now
    job.store.finish("recordings", list(written))
    sensors = [sensor for sensor in sensors if sensor.sequence.name in written]
    summary = evaluate(job, sensors, {"depth_maps": written}, errors=failures.reasons)
    report(job, summary)


def make_sensor(job: Job, sequence: Sequence) -> DepthSensor:
    """Make the network the depth sensor of a sequence."""
    assert job.parts.estimator is not None
    sensing = job.options.sensing
    return DepthSensor(
        job.parts.estimator,
        sequence,
        sensing.cache or job.store.path("cache"),
        name=job.parts.ids["depth"],
        percentile=sensing.baseline_percentile,
        batch_size=sensing.frames_at_once,
        monitor=job.display,
        computing=sensing,
        fabric=job.trainer.fabric,
    )


def evaluate(
    job: Job,
    sensors: list[DepthSensor],
    more: dict[str, Any] | None = None,
    training: dict[str, Any] | None = None,
    errors: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Evaluate the predicted depth where there is truth and write the summary.

    Args:
        job: The run.
        sensors: The network on each sequence.
        more: Further entries of the summary.
        training: Figures of the training that came before.
        errors: What recordings failed with, by their names.

    Returns:
        The summary.
    """

    def work() -> dict[str, Any] | None:
        write_samples(sensors, job.store.loop(0, "depth", "samples.npz"))
        return depth_figures(sensors, job.options.evaluation)

    figures = job.store.step("loops/00/depth", work)
    uncertainty = job.store.step("loops/00/uncertainty", lambda: uncertainty_figures(sensors, job.options.evaluation))
    if uncertainty:
        job.display.say(describe_uncertainty(uncertainty))
    statistics = {sensor.sequence.name: sensor.prepare() for sensor in sensors}
    entry = {
        "loop": 0,
        "name": job.parts.ids["depth"],
        "pose": {},
        "depth": figures,
        "uncertainty": uncertainty,
        "training": training,
        "baseline": {name: found.adaptive_baseline for name, found in statistics.items()},
        "depth_max": {name: found.depth_max for name, found in statistics.items()},
    }
    if job.options.sensing.cache is None:
        for sensor in sensors:
            sensor.forget()
    sequences = [sensor.sequence for sensor in sensors]
    return write_summary(job.store, job.identity, sequences, [entry], errors=errors, more=more)


def _write_depth(job: Job, sensor: DepthSensor) -> dict[str, Any]:
    """Write ``depth/SEQ/{png,preview,npz}``; return the counts and the scale of the PNG values."""
    options = job.options.task
    assert isinstance(options, DepthTask)
    statistics = sensor.prepare()
    near, far = _preview_range(statistics.median)
    indices = range(0, len(sensor), options.every)
    clipped = 0
    with job.store.new_folder(job.store.path("depth", sensor.sequence.name)) as folder:
        with job.display.stage(f"Writing {sensor.sequence.name}", len(indices)) as progress:
            for index in indices:
                depth = sensor.depth(index)
                clipped += write_depth_png(depth, folder / "png" / f"{index:06d}.png", options.png_scale)
                write_preview(depth, folder / "preview" / f"{index:06d}.jpg", near, far)
                if options.npz:
                    (folder / "npz").mkdir(exist_ok=True)
                    np.savez_compressed(folder / "npz" / f"{index:06d}.npz", depth=depth)
                progress.advance()
        noted = {
            "frames": len(indices),
            "png_scale": options.png_scale,
            "unit": _UNITS[sensor.estimator.depth_kind],
            "pixels_beyond_png": clipped,
            "preview_range": [near, far],
        }
        write_json(folder / "depth.json", noted)
    return noted


def _preview_range(medians: list[float]) -> tuple[float, float]:
    """One range of depth for the colours of a whole sequence, so that they do not flicker."""
    middle = float(np.median(medians))
    return middle / 4, middle * 4


def write_depth_png(depth: NDArray[np.float32], path: Path, scale: float) -> int:
    """Write depth as a 16-bit PNG of ``depth * scale``, as KITTI does; 0 stands for unknown.

    Returns:
        The number of pixels too far for 16 bits, written as 65535.
    """
    values = np.rint(depth * scale)
    write_image(path, np.clip(values, 1, _PNG_MAX).astype(np.uint16))
    return int(np.count_nonzero(values > _PNG_MAX))


def write_preview(depth: NDArray[np.float32], path: Path, near: float, far: float) -> None:
    """Write inverse depth in colours, bright for near."""
    import cv2

    inverse = (np.log(far) - np.log(np.clip(depth, near, far))) / (np.log(far) - np.log(near))
    write_image(path, cv2.applyColorMap((255 * inverse).astype(np.uint8), cv2.COLORMAP_MAGMA))


def write_image(path: Path, image: NDArray[Any]) -> None:
    """Write an image in the format of the file's suffix; ``cv2.imwrite`` would not say why it could not.

    Args:
        path: The file; its folder is made if needed.
        image: (H, W) or (H, W, 3) BGR, as OpenCV has it.

    Raises:
        DiskError: If the disk is full, or may not be written to.
    """
    import cv2

    encoded = cv2.imencode(path.suffix, image)[1]
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded.tobytes())
