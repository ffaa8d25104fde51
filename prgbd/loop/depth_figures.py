"""How good the network's depth is, and pictures of it, from what the sensors have predicted already."""

from __future__ import annotations

from collections.abc import Sequence as Seq
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError
from prgbd.evaluation.depth import CROPS, DEFAULT_CAP, DepthEvaluation
from prgbd.io.files import atomic_path
from prgbd.loop.sensing import DepthSensor

SAMPLES = 6
NEAREST = DEFAULT_CAP[0]
OUTDOORS = 30.0  # metres; a cap from here on gets the caps and bins of a street


@dataclass(frozen=True)
class DepthProtocol:
    """How predicted depth is compared with the truth.

    Attributes:
        images: At most this many evenly spaced images per sequence; None for all.
        cap: Metres beyond which truth is ignored and to which predictions are clamped.
        crop: ``none``, ``garg`` or ``eigen``.
        median_scaling: Whether each prediction is scaled by the ratio of the medians.
        caps: Further caps, each evaluated by the full protocol; None chooses them by ``cap``.
        bins: Ascending depths in metres between which errors are collected; None chooses them by ``cap``.

    Raises:
        ConfigError: If a value cannot work.
    """

    images: int | None = 100
    cap: float = 80.0
    crop: str = "none"
    median_scaling: bool = True
    caps: tuple[float, ...] | None = None
    bins: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not self.cap > 0:
            raise ConfigError(f"evaluation.depth_cap is {self.cap}; it must be positive (metres).")
        if self.images is not None and self.images < 1:
            raise ConfigError(f"evaluation.depth_images is {self.images}; it must be at least 1, or null for all.")
        if self.crop not in CROPS:
            raise ConfigError(f"evaluation.depth_crop is '{self.crop}'; choose {', '.join(CROPS)}.")
        if self.caps is not None and not all(cap > 0 for cap in self.caps):
            raise ConfigError(f"evaluation.depth_caps is {list(self.caps)}; the caps must be positive (metres).")
        if self.bins and (len(self.bins) < 2 or min(self.bins) < 0 or np.any(np.diff(self.bins) <= 0)):
            raise ConfigError(
                f"evaluation.depth_bins is {list(self.bins)}; give at least two ascending depths in metres, or []."
            )

    @property
    def chosen_caps(self) -> tuple[float, ...]:
        """The further caps: the paper's 30, 40, ... 80 m up to ``cap``, or 2, 4, ... 10 m where ``cap`` is indoors."""
        if self.caps is not None:
            return self.caps
        candidates = range(30, 81, 10) if self.cap >= OUTDOORS else range(2, 11, 2)
        return tuple(float(cap) for cap in candidates if cap <= self.cap)

    @property
    def chosen_bins(self) -> tuple[float, ...]:
        """The limits of the depth bins up to ``cap``, finer indoors."""
        if self.bins is not None:
            return self.bins
        limits = (0, 5, 10, 15, 20, 30, 40, 60, 80) if self.cap >= OUTDOORS else range(11)
        return (*(float(limit) for limit in limits if limit < self.cap), self.cap)


def evenly(count: int, wanted: int | None) -> NDArray[np.int64]:
    """Return at most ``wanted`` evenly spaced numbers below ``count``; all for None."""
    if wanted is None or wanted >= count:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, max(wanted, 1)).round().astype(np.int64))


def depth_figures(sensors: Seq[DepthSensor], protocol: DepthProtocol | None = None) -> dict[str, Any] | None:
    """Evaluate the predicted depth of sequences against their truth.

    Args:
        sensors: The network on each sequence.
        protocol: Images, cap, crop, scaling, further caps and bins; the defaults for None.

    Returns:
        The metrics and their protocol, or None without any truth.
    """
    protocol = protocol or DepthProtocol()
    evaluation = DepthEvaluation(
        (NEAREST, protocol.cap), protocol.crop, protocol.median_scaling, protocol.chosen_caps, protocol.chosen_bins
    )
    truth_seen = False
    for sensor in sensors:
        for index in evenly(len(sensor), protocol.images):
            truth = sensor.sequence.depth(int(index))
            if truth is None:
                evaluation.skip()
                continue
            truth_seen = True
            evaluation.add(truth, sensor.depth(int(index)))
    return evaluation.result() if truth_seen else None


def write_samples(sensors: Seq[DepthSensor], path: Path, count: int = SAMPLES) -> None:
    """Write a few frames with their predicted and true depth, the same frames in every loop.

    The file holds ``images`` (n, H, W, 3) uint8, ``depth`` (n, H, W) float32 in the network's unit, ``truth``
    (n, H, W) float32 metres with 0 where unknown (absent without any), ``frame_index`` (n,) and ``sequence`` (n,).
    Sequences of another size than the first are resized to it.

    Args:
        sensors: The network on each sequence.
        path: The ``.npz`` file.
        count: How many frames in all, at least one for each of the first ``count`` sequences.
    """
    chosen = sensors[:count]
    share = max(1, count // max(len(chosen), 1))
    camera = chosen[0].sequence.camera
    size = (camera.width, camera.height)
    columns: dict[str, list[Any]] = {"images": [], "depth": [], "truth": [], "frame_index": [], "sequence": []}
    for sensor in chosen:
        for index in evenly(len(sensor), share + 2)[1:-1] if len(sensor) > share + 2 else evenly(len(sensor), share):
            frame = sensor.frame(int(index))
            assert frame.depth is not None
            columns["images"].append(cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA))
            columns["depth"].append(cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST))
            columns["truth"].append(_truth(sensor.sequence, int(index), size))
            columns["frame_index"].append(int(index))
            columns["sequence"].append(sensor.sequence.name)
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    if not arrays["truth"].any():
        del arrays["truth"]
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)  # type: ignore[arg-type]


def _truth(sequence: Sequence, index: int, size: tuple[int, int]) -> NDArray[np.float32]:
    truth = sequence.depth(index)
    if truth is None:
        return np.zeros(size[::-1], np.float32)
    return np.asarray(cv2.resize(truth, size, interpolation=cv2.INTER_NEAREST), np.float32)
