"""One measured run of a SLAM system over a sequence."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import prgbd
from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError
from prgbd.core.types import Frame, SlamResult

# ORB-SLAM2's TUM settings: bf = 40 at fx = 500.
KINECT_BASELINE = 0.08
KITTI_BASELINE_OF_DEPTH = 0.54 / 80.0
# Frames are read ahead, with the clock stopped, up to this many bytes at a time.
READ_AHEAD = 1 << 30
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
    """

    sequence: Sequence
    mode: str
    positions: range
    baseline: float | None = None
    inverse: dict[int, NDArray[np.float32]] = field(default_factory=dict)

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
        """Yield the frames in blocks that fit into ``READ_AHEAD``."""
        first = self.frame(self.positions[0])
        size = sum(a.nbytes for a in (first.image, first.depth, first.right) if a is not None)
        step = max(1, READ_AHEAD // size)
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
        peak_mib: Peak memory of the process, MiB, with the frames that were read ahead.
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
    sequence: Sequence, mode: str, positions: range, depth: dict[str, Any], baseline: float | None, percentile: float
) -> Source:
    """Choose the baseline, and predict depth where the mode asks for it.

    Raises:
        ConfigError: If the mode does not exist.
    """
    if mode not in ("mono", "rgbd", "stereo", "pseudo_rgbd"):
        raise ConfigError(f"There is no mode '{mode}'; choose mono, rgbd, stereo or pseudo_rgbd.")
    source = Source(sequence, mode, positions)
    if mode == "pseudo_rgbd":
        source.inverse = _predict(sequence, positions, depth)
        lowest = np.percentile(np.stack(list(source.inverse.values())), 100.0 - percentile)
        source.baseline = baseline or KITTI_BASELINE_OF_DEPTH / float(lowest)
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
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return Measured(result, np.array(seconds), np.array(cpu), ended, peak)


def warm_up(source: Source, slam: dict[str, Any]) -> None:
    """Let kernels load or compile on a few frames."""
    with _made(source, slam, 0) as system:
        for i in source.positions[:WARM_UP]:
            system.track(source.frame(i))
        system.finish()


def _made(source: Source, slam: dict[str, Any], seed: int) -> prgbd.GeometricSLAM:
    options = dict(slam)
    system = prgbd.make_slam(options.pop("id", "orb_gtsam"), **options)
    mode = "rgbd" if source.mode == "pseudo_rgbd" else source.mode
    sequence = source.sequence
    fps = sequence.fps / source.positions.step
    system.reset(sequence.camera, mode, baseline=source.baseline, fps=fps, seed=seed)
    return system
