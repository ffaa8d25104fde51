"""One measured run of a SLAM system over a sequence."""

from __future__ import annotations

import contextlib
import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import prgbd
from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError
from prgbd.core.slam import adaptive_baseline
from prgbd.core.types import Frame, SlamResult

# ORB-SLAM2's TUM settings: bf = 40 at fx = 500.
KINECT_BASELINE = 0.08
# Frames of a first run that is not counted: it loads or compiles kernels.
WARM_UP = 6


@dataclass
class Source:
    """The frames of a benchmark.

    Attributes:
        sequence: The recording.
        mode: ``mono``, ``rgbd``, ``stereo`` or ``pseudo_rgbd``.
        positions: Frames to use, in order.
        baseline: Metres, None for mono.
        inverse: Predicted inverse depth by frame, for ``pseudo_rgbd``.
        read_ahead: Bytes of frames that are read at a time, with the clock stopped.
    """

    sequence: Sequence
    mode: str
    positions: range
    baseline: float | None = None
    inverse: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    read_ahead: int = 1 << 30

    def frame(self, i: int) -> Frame:
        """Return frame ``i`` as SLAM is to see it."""
        frame = self.sequence.frame(i)
        if self.mode == "mono":
            return frame.with_depth(None)
        if self.mode == "pseudo_rgbd":
            size = (self.sequence.camera.width, self.sequence.camera.height)
            return frame.with_depth((1.0 / cv2.resize(self.inverse[i], size)).astype(np.float32))
        return frame

    def blocks(self) -> Iterator[list[Frame]]:
        """Yield the frames in blocks that fit into ``read_ahead``."""
        first = self.frame(self.positions[0])
        size = sum(a.nbytes for a in (first.image, first.depth, first.right) if a is not None)
        step = max(1, self.read_ahead // size)
        for start in range(0, len(self.positions), step):
            yield [self.frame(i) for i in self.positions[start : start + step]]


@dataclass
class Measured:
    """What a run gave and cost.

    Attributes:
        result: The SLAM result.
        seconds: (F,) wall time of every ``track``.
        cpu_seconds: (F,) CPU time of the calling thread in every ``track``.
        finish_seconds: Wall time of ``finish``.
        peak_mib: Peak memory of the process during this run, MiB, with the frames that were read ahead.
    """

    result: SlamResult
    seconds: NDArray[np.float64]
    cpu_seconds: NDArray[np.float64]
    finish_seconds: float
    peak_mib: float

    @property
    def fps(self) -> float:
        """Frames per second of wall time in ``track``."""
        return len(self.seconds) / float(self.seconds.sum())

    @property
    def fps_with_finish(self) -> float:
        """The same with the time of ``finish``."""
        return len(self.seconds) / (float(self.seconds.sum()) + self.finish_seconds)


def make_source(
    sequence: Sequence,
    mode: str,
    positions: range,
    depth: dict[str, Any],
    baseline: float | None,
    percentile: float,
    read_ahead: int,
) -> Source:
    """Choose the baseline, and predict depth where the mode asks for it.

    Raises:
        ConfigError: If the mode does not exist, or the recording lacks the right images that it needs.
    """
    if mode not in ("mono", "rgbd", "stereo", "pseudo_rgbd"):
        raise ConfigError(f"There is no mode '{mode}'; choose mono, rgbd, stereo or pseudo_rgbd.")
    if mode == "stereo" and (sequence.frame(positions[0]).right is None or not (baseline or sequence.baseline)):
        raise ConfigError(f"The sequence '{sequence.name}' has no right images; mode=stereo needs them.")
    source = Source(sequence, mode, positions, read_ahead=read_ahead)
    if mode == "pseudo_rgbd":
        source.inverse = _predict(sequence, positions, depth)
        lowest = np.percentile(np.stack(list(source.inverse.values())), 100.0 - percentile)
        source.baseline = baseline or adaptive_baseline(1.0 / float(lowest))
    elif mode != "mono":
        source.baseline = baseline or sequence.baseline or KINECT_BASELINE
    return source


def _predict(sequence: Sequence, positions: range, depth: dict[str, Any]) -> dict[int, NDArray[np.float32]]:
    """Predict inverse depth for every frame at the network's size, (h, w) float32."""
    chosen = dict(depth)
    estimator = prgbd.make_depth(chosen.pop("id", "rt_monodepth"), **chosen)
    height, width = estimator.input_size
    made = {}
    for i in tqdm(positions, "depth", disable=not sys.stderr.isatty(), leave=False):
        predicted = estimator.predict(sequence.frame(i).image)
        made[i] = cv2.resize(1.0 / predicted, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    return made


def measure(source: Source, slam: dict[str, Any], seed: int, label: str = "slam") -> Measured:
    """Run SLAM once over all frames; reading frames is not counted."""
    seconds: list[float] = []
    cpu: list[float] = []
    forget_peak()
    with _made(source, slam, seed) as system:
        with tqdm(total=len(source.positions), desc=label, disable=not sys.stderr.isatty(), leave=False) as bar:
            for block in source.blocks():
                for frame in block:
                    wall, used = time.perf_counter(), time.thread_time()
                    system.track(frame)
                    seconds.append(time.perf_counter() - wall)
                    cpu.append(time.thread_time() - used)
                    bar.update()
        start = time.perf_counter()
        result = system.finish()
        ended = time.perf_counter() - start
    return Measured(result, np.array(seconds), np.array(cpu), ended, peak_mib())


def forget_peak() -> None:
    """Let the peak of memory start anew, where Linux allows it; elsewhere it is that of the process so far."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_mib() -> float:
    """Peak resident memory of the process, MiB: since ``forget_peak`` where /proc tells it."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024.0
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def warm_up(source: Source, slam: dict[str, Any]) -> None:
    """Let kernels load or compile on a few frames."""
    with _made(source, slam, 0) as system:
        for i in source.positions[:WARM_UP]:
            system.track(source.frame(i))
        system.finish()


def _made(source: Source, slam: dict[str, Any], seed: int) -> prgbd.GeometricSLAM:
    options = dict(slam)
    system = prgbd.make_slam(options.pop("id", "orb_gtsam"), **options)
    # Systems without a mode of their own for pseudo depth take it as a sensor's.
    own = source.mode in system.modes
    mode = "rgbd" if source.mode == "pseudo_rgbd" and not own else source.mode
    sequence = source.sequence
    fps = sequence.fps / source.positions.step
    system.reset(sequence.camera, mode, baseline=source.baseline, fps=fps, seed=seed)
    return system
