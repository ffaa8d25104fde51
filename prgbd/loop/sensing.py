"""``DepthSensor``: a depth network used as the depth sensor of RGB-D SLAM."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Generator, Iterator
from collections.abc import Sequence as Many
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from prgbd.core import wrappers
from prgbd.core.computing import Computing
from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator, resized_sigma, weights_fingerprint
from prgbd.core.errors import ContractError
from prgbd.core.slam import adaptive_baseline
from prgbd.core.types import Frame
from prgbd.core.validation import check_depth_shape, check_sigma_map, require
from prgbd.loop.decoding import Batch, decoded
from prgbd.loop.monitor import Monitor, SilentMonitor
from prgbd.loop.predicted_depth import PredictedDepth

if TYPE_CHECKING:
    from lightning.fabric import Fabric

_SUBSAMPLING = 8
_FORMAT = "inverse depth, deviations in bytes"
_MIXED = "gave deviations of depth for some frames alone; it must give them for all, or for none."

Maps = tuple[NDArray[np.float32], NDArray[np.float32] | None]
"""Depth of a frame, (h, w), and the standard deviation of its logarithm where the network predicts it."""


@dataclass(frozen=True)
class DepthStatistics:
    """What the predicted depth of a sequence looks like, in the network's unit.

    Attributes:
        depth_max: The largest depth over the sequence, or its percentile where that was asked for.
        median: Median depth of every frame, whose jumps show the network's scale drifting.
        maximum: Largest depth of every frame.
        sigma: Median predicted standard deviation of log depth of every frame; None where the network predicts none.
    """

    depth_max: float
    median: list[float]
    maximum: list[float]
    sigma: list[float] | None = None

    @property
    def adaptive_baseline(self) -> float:
        """The virtual baseline b = (0.54 / 80) * d_max, metres if the network is metric."""
        return adaptive_baseline(self.depth_max)

    def diagnostics(self) -> dict[str, float]:
        """Return the numbers that show at a glance whether the network keeps its scale, for ``slam.json``."""
        median = np.asarray(self.median)
        steps = np.abs(np.diff(np.log(median))) if len(median) > 1 else np.zeros(1)
        return {
            "depth_max": self.depth_max,
            "median_depth": float(np.median(median)),
            "median_depth_lowest": float(median.min()),
            "median_depth_highest": float(median.max()),
            "largest_scale_step": float(np.expm1(steps.max())),
            **({} if self.sigma is None else {"median_sigma": float(np.median(self.sigma))}),
        }


class DepthSensor:
    """Frames of a sequence with the depth that a network predicts for them.

    Depth is predicted once per frame at the network's size and kept in a file with its standard deviation, so memory
    does not grow with the sequence; both are resized to the image's size when a frame is asked for.

    Args:
        estimator: The network; it is used in evaluation mode.
        sequence: The recording.
        cache: Folder for the files of predicted depth. Their names hold the plug-in, its weights and the recording.
        name: Id of the depth plug-in, for messages and the cache's name.
        percentile: d_max is this percentile of all predicted depths; 100 is the paper's largest depth.
        batch_size: Frames per forward pass; None is 8 on a GPU, 1 on the CPU, and there 4 in half precision, where a
            pass spends more of its time on the weights.
        monitor: Who watches.
        computing: Precision and speed of the network; by default exact.
        fabric: Moves the network to its device; by default it predicts where it lies.
    """

    def __init__(
        self,
        estimator: DepthEstimator,
        sequence: Sequence,
        cache: Path,
        *,
        name: str,
        percentile: float = 100.0,
        batch_size: int | None = None,
        monitor: Monitor | None = None,
        computing: Computing | None = None,
        fabric: Fabric | None = None,
    ) -> None:
        self.estimator = estimator
        self.sequence = sequence
        self.name = name
        self.percentile = percentile
        self._monitor = monitor or SilentMonitor()
        self._computing = computing or Computing()
        self._fabric = fabric
        lies = next((p.device for p in estimator.parameters()), torch.device("cpu"))
        self._device = lies if fabric is None else fabric.device
        self._batch_size = batch_size or self.automatic_batch_size(self._computing, self._device)
        key = cache_key(estimator, sequence, name, self._computing.description(self._device))
        self._files = PredictedDepth(cache, f"{sequence.name}-{key}", len(sequence))
        self._statistics: DepthStatistics | None = None

    @property
    def path(self) -> Path:
        """The file of inverse depth."""
        return self._files.path

    @staticmethod
    def automatic_batch_size(computing: Computing, device: torch.device) -> int:
        """Return how many frames a forward pass takes unless one is told."""
        if device.type != "cpu":
            return 8
        return 1 if computing.dtype(device) == torch.float32 else 4

    def prepare(self) -> DepthStatistics:
        """Predict depth for the whole sequence unless it is in the cache.

        Raises:
            ContractError: If the network gives depth that is not positive and finite; it names plug-in and frame.
        """
        if self._statistics is None:
            if not self._files.complete:
                self._predict_all()
            self._statistics = self._read_statistics()
        return self._statistics

    def __len__(self) -> int:
        return len(self.sequence)

    def __iter__(self) -> Iterator[Frame]:
        """Yield every frame with its pseudo depth, in order."""
        for index in range(len(self)):
            yield self.frame(index)

    def frame(self, index: int) -> Frame:
        """Return a frame whose depth, and what is known of its deviation, are the network's, at the image's size."""
        return self.sequence.frame(index).with_depth(self.depth(index), self.sigma(index))

    def depth(self, index: int) -> NDArray[np.float32]:
        """Return the predicted depth of a frame at the image's size, (H, W) float32 in the network's unit."""
        self.prepare()
        camera = self.sequence.camera
        # The inverse is what is interpolated: an edge between near and far must not smear towards the far side.
        inverse: NDArray[Any] = self._files.inverse(index)
        if inverse.shape != (camera.height, camera.width):
            inverse = cv2.resize(inverse, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
        return (1.0 / inverse).astype(np.float32)

    def sigma(self, index: int) -> NDArray[np.float32] | None:
        """Return the standard deviation of a frame's log depth, (H, W) float32; None where none is predicted."""
        if self.prepare().sigma is None:
            return None
        camera = self.sequence.camera
        return resized_sigma(self._files.sigma(index), (camera.height, camera.width))

    def forget(self) -> None:
        """Delete the files of predicted depth."""
        self._files.forget()

    def _predict_all(self) -> None:
        count = len(self.sequence)
        median, maximum = np.zeros(count), np.zeros(count)
        sigmas: list[float] = []
        with (
            self._files.writing() as writer,
            self._monitor.stage(f"Depth of {self.sequence.name}", count) as progress,
            contextlib.closing(self._predictions()) as predictions,
        ):
            for index, (depth, sigma) in enumerate(predictions):
                self._check(depth, sigma, index)
                require(index == 0 or (sigma is not None) == bool(sigmas), self._who(index), _MIXED)
                writer.add(index, depth, sigma)
                median[index], maximum[index] = float(np.median(depth)), float(depth.max())
                if sigma is not None:
                    sigmas.append(float(np.median(sigma)))
                progress.advance()
            depth_max = float(maximum.max()) if self.percentile >= 100 else self._percentile(writer.inverse)
        figures = DepthStatistics(depth_max, median.tolist(), maximum.tolist(), sigmas or None)
        self._files.write_figures(asdict(figures))

    def _predictions(self) -> Generator[Maps]:
        """Yield the maps of every frame: at the network's size, or what the plug-in's own ``predict`` gives."""
        if self._fabric is not None:
            self._fabric.to_device(self.estimator)  # every training leaves it on the CPU
        was_training = self.estimator.training
        self.estimator.eval()
        try:
            with (
                self.estimator.finest_scale(),
                self._computing.applied(self.estimator, self._device, self._monitor.say),
                contextlib.closing(self._decoded()) as batches,
            ):
                for batch in batches:
                    yield from self._predict(*batch)
        finally:
            self.estimator.train(was_training)

    def _decoded(self) -> Generator[Batch]:
        """Yield decoded batches, prepared for the network unless the plug-in brings its own ``predict``."""

        def prepare(frames: list[Frame]) -> torch.Tensor:
            return self._computing.stacked([self.estimator.observe(self.sequence, frame) for frame in frames])

        return decoded(self.sequence, self._batch_size, self._device, None if self._brings_predict else prepare)

    @property
    def _brings_predict(self) -> bool:
        kind = type(self.estimator)
        own = kind.predict is DepthEstimator.predict and kind.predict_with_sigma is DepthEstimator.predict_with_sigma
        return not own

    def _predict(self, frames: list[Frame], batch: torch.Tensor | None) -> list[Maps]:
        if batch is None:
            maps = [self.estimator.predict_with_sigma(frame.image) for frame in frames]
            for frame, (depth, _) in zip(frames, maps, strict=True):
                check_depth_shape(depth, frame.image.shape[:2], self._who(frame.index))
            return maps
        try:
            prediction = self.estimator(self._computing.arranged(batch.to(self._device)))
        except ContractError as error:
            raise ContractError(f"{error} It happened at frame {frames[0].index} of '{self.sequence.name}'.") from error
        depths = _arrays(prediction.depth)
        sigmas = [None] * len(depths) if prediction.sigma is None else list(_arrays(prediction.sigma))
        return list(zip(depths, sigmas, strict=True))

    def _who(self, index: int) -> str:
        return f"The depth plug-in '{self.name}', frame {index} of '{self.sequence.name}',"

    def _check(self, depth: NDArray[np.float32], sigma: NDArray[np.float32] | None, index: int) -> None:
        bad = int(np.count_nonzero(~(np.isfinite(depth) & (depth > 0))))
        if bad:
            raise ContractError(
                f"The depth plug-in '{self.name}' predicted {bad} values that are zero, negative, NaN or infinite at "
                f"frame {index} of '{self.sequence.name}'; depth must be positive and finite, so check its weights."
            )
        if sigma is not None:
            check_sigma_map(sigma, (depth.shape[0], depth.shape[1]), self._who(index))

    def _percentile(self, inverse: NDArray[np.float32]) -> float:
        """The percentile of depth over a regular subset of pixels: every pixel would not fit into memory."""
        step = _SUBSAMPLING if min(inverse.shape[1:]) >= 8 * _SUBSAMPLING else 1
        pixels = np.concatenate([frame[::step, ::step].ravel() for frame in inverse])
        return float(1.0 / np.percentile(pixels, 100.0 - self.percentile))

    def _read_statistics(self) -> DepthStatistics:
        count, stored = len(self.sequence), self._files.read_figures()
        columns: list[Any] = [stored.get(name) for name in ("median", "maximum")] if isinstance(stored, dict) else []
        sigma = stored.get("sigma") if columns else None
        if not columns or not all(_are_positive(column, count) for column in (*columns, sigma or columns[0])):
            raise self._files.damaged("its figures are not those of the recording")
        median, maximum = columns
        # The cache may have been filled under another percentile.
        depth_max = float(max(maximum)) if self.percentile >= 100 else self._percentile(self._files.all_inverse())
        return DepthStatistics(depth_max, median, maximum, sigma)


def _arrays(maps: torch.Tensor) -> NDArray[np.float32]:
    """(B, 1, H, W) maps as (B, H, W) float32."""
    return np.asarray(maps[:, 0].float().cpu().numpy(), np.float32)


def _are_positive(column: Any, count: int) -> bool:
    """Whether a column of figures has a finite positive number for every frame."""
    numbers = isinstance(column, list) and all(type(value) in (int, float) for value in column)
    return numbers and len(column) == count and all(0 < value < float("inf") for value in column)


def cache_key(estimator: DepthEstimator, sequence: Sequence, name: str, computing: Many[str] = ()) -> str:
    """Return what the predicted depth depends on: plug-in, weights, input size, recording, options and precision."""
    parts: list[Any] = [
        _FORMAT,
        name,
        weights_fingerprint(estimator),
        list(estimator.input_size),
        sequence.name,
        sequence.camera.to_dict(),
        len(sequence),
        [float(sequence.timestamps[0]), float(sequence.timestamps[-1])],
        hashlib.sha256(np.ascontiguousarray(sequence.frame(0).image).tobytes()).hexdigest()[:16],
        *wrappers.description(estimator),
        *computing,
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]
