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
from prgbd.core.depth import DepthEstimator, weights_fingerprint
from prgbd.core.errors import ContractError, DataError
from prgbd.core.slam import adaptive_baseline
from prgbd.core.types import Frame
from prgbd.core.validation import check_depth_shape
from prgbd.io.disk import allocated
from prgbd.io.files import atomic_path, read_json, write_json
from prgbd.loop.decoding import Batch, decoded
from prgbd.loop.monitor import Monitor, SilentMonitor

if TYPE_CHECKING:
    from lightning.fabric import Fabric

_SUBSAMPLING = 8


@dataclass(frozen=True)
class DepthStatistics:
    """What the predicted depth of a sequence looks like, in the network's unit.

    Attributes:
        depth_max: The largest depth over the sequence, or its percentile where that was asked for.
        median: Median depth of every frame, whose jumps show the network's scale drifting.
        maximum: Largest depth of every frame.
    """

    depth_max: float
    median: list[float]
    maximum: list[float]

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
        }


class DepthSensor:
    """Frames of a sequence with the depth that a network predicts for them.

    Depth is predicted once per frame at the network's size and its inverse kept in a file (4 bytes a pixel), so
    memory does not grow with the sequence; it is resized to the image's size when a frame is asked for.

    Args:
        estimator: The network; it is used in evaluation mode.
        sequence: The recording.
        cache: Folder for the file of predicted depth. The name holds the plug-in, its weights and the recording.
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
        stem = f"{sequence.name}-{key}"
        self.path = cache / f"{stem}.npy"
        self._statistics_path = cache / f"{stem}.json"
        self._inverse: NDArray[np.float32] | None = None
        self._statistics: DepthStatistics | None = None

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
            if not (self.path.is_file() and self._statistics_path.is_file()):
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
        """Return a frame whose depth is the network's, (H, W) float32 at the image's size."""
        frame = self.sequence.frame(index)
        return frame.with_depth(self.depth(index))

    def depth(self, index: int) -> NDArray[np.float32]:
        """Return the predicted depth of a frame at the image's size, (H, W) float32 in the network's unit."""
        self.prepare()
        if self._inverse is None:
            self._inverse = self._stored()
        camera = self.sequence.camera
        # The inverse is what is interpolated: an edge between near and far must not smear towards the far side.
        inverse = np.array(self._inverse[index])
        if not (np.isfinite(inverse).all() and inverse.min() > 0):
            raise self._damaged(f"frame {index} holds values that are no depth")
        if inverse.shape != (camera.height, camera.width):
            inverse = cv2.resize(inverse, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
        return (1.0 / inverse).astype(np.float32)

    def forget(self) -> None:
        """Delete the file of predicted depth."""
        self._inverse = None
        self.path.unlink(missing_ok=True)
        self._statistics_path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # others may have left something there
            self.path.parent.rmdir()

    def _predict_all(self) -> None:
        count = len(self.sequence)
        median, maximum = np.zeros(count), np.zeros(count)
        with (
            atomic_path(self.path) as temporary,
            self._monitor.stage(f"Depth of {self.sequence.name}", count) as progress,
            contextlib.closing(self._predictions()) as predictions,
        ):
            file: NDArray[np.float32] | None = None
            for index, depth in enumerate(predictions):
                if file is None:
                    file = allocated(temporary, (count, *depth.shape), np.float32)
                self._check(depth, index)
                file[index] = 1.0 / depth
                median[index], maximum[index] = float(np.median(depth)), float(depth.max())
                progress.advance()
            assert file is not None  # a sequence has at least one frame
            depth_max = float(maximum.max()) if self.percentile >= 100 else self._percentile(file)
            file.flush()  # type: ignore[attr-defined]
            del file
        write_json(self._statistics_path, asdict(DepthStatistics(depth_max, median.tolist(), maximum.tolist())))

    def _predictions(self) -> Generator[NDArray[np.float32]]:
        """Yield the depth of every frame, (h, w): at the network's size, or what the plug-in's own `predict` gives."""
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

        brings_predict = type(self.estimator).predict is not DepthEstimator.predict
        return decoded(self.sequence, self._batch_size, self._device, None if brings_predict else prepare)

    def _predict(self, frames: list[Frame], batch: torch.Tensor | None) -> NDArray[np.float32]:
        """Predict (n, h, w) depth."""
        if batch is None:
            maps = [self.estimator.predict(frame.image) for frame in frames]
            for frame, depth in zip(frames, maps, strict=True):
                who = f"The depth plug-in '{self.name}', frame {frame.index} of '{self.sequence.name}',"
                check_depth_shape(depth, frame.image.shape[:2], who)
            return np.stack(maps)
        try:
            prediction = self.estimator(self._computing.arranged(batch.to(self._device)))
        except ContractError as error:
            raise ContractError(f"{error} It happened at frame {frames[0].index} of '{self.sequence.name}'.") from error
        return np.asarray(prediction.depth[:, 0].float().cpu().numpy(), np.float32)

    def _check(self, depth: NDArray[np.float32], index: int) -> None:
        bad = int(np.count_nonzero(~(np.isfinite(depth) & (depth > 0))))
        if bad:
            raise ContractError(
                f"The depth plug-in '{self.name}' predicted {bad} values that are zero, negative, NaN or infinite at "
                f"frame {index} of '{self.sequence.name}'; depth must be positive and finite, so check its weights."
            )

    def _percentile(self, inverse: NDArray[np.float32]) -> float:
        """The percentile of depth over a regular subset of pixels: every pixel would not fit into memory."""
        step = _SUBSAMPLING if min(inverse.shape[1:]) >= 8 * _SUBSAMPLING else 1
        pixels = np.concatenate([frame[::step, ::step].ravel() for frame in inverse])
        return float(1.0 / np.percentile(pixels, 100.0 - self.percentile))

    def _stored(self) -> NDArray[np.float32]:
        """Open the file of inverse depth.

        Raises:
            DataError: If it is damaged.
        """
        try:
            stored: NDArray[np.float32] = np.load(self.path, mmap_mode="r")
        except (OSError, ValueError, EOFError, SyntaxError) as error:
            raise self._damaged(type(error).__name__) from error
        if not isinstance(stored, np.ndarray) or stored.dtype != np.float32 or stored.ndim != 3 or not stored.size:
            raise self._damaged("it holds something else")
        if len(stored) != len(self.sequence):
            raise self._damaged(f"it holds {len(stored)} frames of {len(self.sequence)}")
        return stored

    def _damaged(self, why: str) -> DataError:
        return DataError(
            f"The predicted depth {self.path} is damaged ({why}); delete it and {self._statistics_path.name}, so that "
            "it is predicted again."
        )

    def _read_statistics(self) -> DepthStatistics:
        count = len(self.sequence)
        stored = read_json(self._statistics_path)
        columns = [stored.get(name) for name in ("median", "maximum")] if isinstance(stored, dict) else []
        if not columns or not all(_are_depths(column, count) for column in columns):
            raise self._damaged("its figures are not those of the recording")
        stored = {"median": columns[0], "maximum": columns[1]}
        if self.percentile < 100:
            # The cache may have been filled under another percentile.
            stored["depth_max"] = self._percentile(self._stored())
        else:
            stored["depth_max"] = float(max(stored["maximum"]))
        return DepthStatistics(**stored)


def _are_depths(column: Any, count: int) -> bool:
    """Whether a column of figures has a finite positive number for every frame."""
    numbers = isinstance(column, list) and all(type(value) in (int, float) for value in column)
    return numbers and len(column) == count and all(0 < value < float("inf") for value in column)


def cache_key(estimator: DepthEstimator, sequence: Sequence, name: str, computing: Many[str] = ()) -> str:
    """Return what the predicted depth depends on: plug-in, weights, input size, recording, options and precision."""
    parts: list[Any] = [
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
