"""Passive checks: what runs around every plug-in unless ``checks=False``, as Gymnasium's environment checker does."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.augmentation import Augmentation
from prgbd.core.criterion import Criterion, Evidence, Verdict
from prgbd.core.data import Sequence
from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import BrokenPluginError, ConfigError, ContractError, PrgbdError
from prgbd.core.refinement_batch import RefinementBatch
from prgbd.core.slam import GeometricSLAM, Listener, SlamView, TrackingResult
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.core.validation import (
    check_augmented,
    check_depth_map,
    check_frame,
    check_loss_value,
    check_name,
    check_prediction,
    check_slam_result,
    check_tracking_result,
    check_view,
    require,
)


@contextmanager
def _named(who: str) -> Iterator[None]:
    """Add to the traceback of an error inside a plug-in which plug-in it was; it cannot end the program."""
    try:
        yield
    except PrgbdError:
        raise
    except SystemExit as error:
        raise BrokenPluginError(f"{who} tried to end the program (sys.exit({error.code!r})); mend it.") from error
    except Exception as error:
        error.add_note(f"{who} raised this; mend it, or choose another plug-in.")
        raise


def with_checks(kind: str, plugin_id: str, plugin: Any) -> Any:
    """Return ``plugin`` with the passive checks of its kind around it."""
    who = f"The {kind} plug-in '{plugin_id}'"
    if kind == "slam":
        return CheckedSLAM(plugin, who)
    if kind == "data":
        return CheckedSequence(plugin, who)
    if kind == "criterion":
        return CheckedCriterion(plugin, who)
    if kind == "augmentation":
        return CheckedAugmentation(plugin, who)
    if kind == "loss":
        plugin.register_forward_hook(functools.partial(_check_loss, who))
        return plugin
    check_declarations(plugin, who)
    plugin.register_forward_hook(functools.partial(_check_forward, who))
    return plugin


def check_declarations(estimator: Any, who: str) -> None:
    """Require the declarations of a depth estimator to make sense."""
    size = getattr(estimator, "input_size", None)
    require(
        isinstance(size, tuple) and len(size) == 2 and all(int(v) > 0 for v in size),
        who,
        f"declares input_size={size!r}; it must be (height, width) in pixels.",
    )
    near_far = getattr(estimator, "depth_range", None)
    require(
        isinstance(near_far, tuple) and len(near_far) == 2 and 0 < near_far[0] < near_far[1],
        who,
        f"declares depth_range={near_far!r}; it must be (nearest, farthest) with 0 < nearest < farthest.",
    )
    kind = getattr(estimator, "depth_kind", None)
    require(
        isinstance(kind, str) and kind in set(DepthKind),
        who,
        f"declares depth_kind={kind!r}; it must be one of {', '.join(DepthKind)}.",
    )


def _check_forward(who: str, module: Any, inputs: tuple[Any, ...], output: Any) -> None:
    check_prediction(output, inputs[0], who)


def _check_loss(who: str, module: Any, inputs: tuple[Any, ...], output: Any) -> None:
    check_loss_value(output, who)


class CheckedCriterion(Criterion):
    """A criterion whose answers are checked."""

    def __init__(self, criterion: Criterion, who: str) -> None:
        self.unwrapped = criterion
        self._who = who

    def objection(self, before: float, after: float, min_improvement: float) -> str:
        """See ``Criterion.objection``."""
        with _named(self._who):
            said = self.unwrapped.objection(before, after, min_improvement)
        require(isinstance(said, str), self._who, f"answers {said!r} in objection; it must be a sentence, or ''.")
        return said

    def judge(self, best: Mapping[str, Evidence], now: Mapping[str, Evidence], min_improvement: float) -> Verdict:
        """See ``Criterion.judge``."""
        with _named(self._who):
            verdict = self.unwrapped.judge(best, now, min_improvement)
        kind = type(verdict).__name__
        require(isinstance(verdict, Verdict), self._who, f"answers a {kind} in judge; it must be a prgbd.Verdict.")
        return verdict


class CheckedAugmentation(Augmentation):
    """An augmentation whose batches are checked."""

    def __init__(self, augmentation: Augmentation, who: str) -> None:
        super().__init__(augmentation.probability)
        self.unwrapped = augmentation
        self._who = who

    def augment(self, batch: RefinementBatch, which: Any, generator: Any) -> RefinementBatch:
        """See ``Augmentation.augment``."""
        with _named(self._who):
            augmented = self.unwrapped.augment(batch, which, generator)
        check_augmented(augmented, batch, self._who)
        return augmented


class CheckedSLAM(GeometricSLAM):
    """A SLAM system that is held to the order of calls, to its inputs and to its outputs."""

    def __init__(self, system: GeometricSLAM, who: str) -> None:
        self.unwrapped = system
        self.modes = system.modes  # type: ignore[misc]
        self._who = who
        self._camera: PinholeCamera | None = None
        self._mode = ""
        self._frames = 0
        self._last = -np.inf
        self._index: int | None = None

    def __getattr__(self, name: str) -> Any:
        if name == "unwrapped":
            raise AttributeError(name)
        return getattr(self.unwrapped, name)

    def reset(
        self, camera: PinholeCamera, mode: str, *, baseline: float | None = None, fps: float = 30.0, seed: int = 0
    ) -> None:
        """See ``GeometricSLAM.reset``."""
        known = isinstance(camera, PinholeCamera)
        require(known, "The caller of reset", f"gave a {type(camera).__name__} where a prgbd.PinholeCamera belongs.")
        if mode not in self.modes:
            raise ConfigError(f"{self._who} has no mode '{mode}'; it supports {', '.join(sorted(self.modes))}.")
        open_ended = mode == "mono" or (mode == "pseudo_rgbd" and baseline is None)
        if not open_ended and (baseline is None or not np.isfinite(baseline) or baseline <= 0):
            raise ConfigError(f"Mode '{mode}' needs a positive baseline in metres, got {baseline}; set slam.baseline.")
        if not np.isfinite(fps) or fps <= 0:
            raise ConfigError(f"The frame rate must be positive, got {fps}; check the time stamps or set data.fps.")
        with _named(self._who):
            self.unwrapped.reset(camera, mode, baseline=baseline, fps=fps, seed=seed)
        self._camera, self._mode, self._frames, self._last = camera, mode, 0, -np.inf
        self._index = None

    def track(self, frame: Frame) -> TrackingResult:
        """See ``GeometricSLAM.track``."""
        if self._camera is None:
            raise ContractError(f"{self._who} was asked to track before reset; call reset first.")
        check_frame(frame, self._camera, "The caller of track")
        require(
            frame.timestamp > self._last,
            f"Frame {frame.index}",
            f"has the time stamp {frame.timestamp:g} s, not later than the frame before ({self._last:g} s).",
        )
        number = frame.index
        if not isinstance(number, Integral) or (self._index is not None and number <= self._index):
            before = "" if self._index is None else f", and the frame before was {self._index}"
            raise ContractError(f"The caller of track gave the frame number {number!r}{before}; count frames upwards.")
        if self._mode in ("rgbd", "pseudo_rgbd") and frame.depth is None:
            raise ContractError(f"Frame {frame.index} has no depth, which mode '{self._mode}' needs; use mode 'mono'.")
        if self._mode == "stereo" and frame.right is None:
            raise ContractError(f"Frame {frame.index} has no right image, which mode 'stereo' needs; use mode 'mono'.")
        with _named(self._who):
            result = self.unwrapped.track(frame)
        check_tracking_result(result, self._who)
        self._frames += 1
        self._last, self._index = frame.timestamp, int(number)
        return result

    def finish(self) -> SlamResult:
        """See ``GeometricSLAM.finish``."""
        if self._camera is None:
            raise ContractError(f"{self._who} was asked to finish before reset; call reset first.")
        with _named(self._who):
            result = self.unwrapped.finish()
        check_slam_result(result, self._frames, self._who)
        self._camera = None
        return result

    def save_map(self, path: Path | str) -> None:
        """See ``GeometricSLAM.save_map``."""
        self.unwrapped.save_map(path)

    def load_map(self, path: Path | str) -> None:
        """See ``GeometricSLAM.load_map``."""
        self.unwrapped.load_map(path)

    def expect_depth(self, kind: DepthKind) -> None:
        """See ``GeometricSLAM.expect_depth``."""
        self.unwrapped.expect_depth(kind)

    def listen(self, listener: Listener | None) -> None:
        """See ``GeometricSLAM.listen``."""
        self.unwrapped.listen(listener)

    def view(self) -> SlamView | None:
        """See ``GeometricSLAM.view``."""
        view = self.unwrapped.view()
        check_view(view, self._who)
        return view

    def close(self) -> None:
        """See ``GeometricSLAM.close``."""
        self.unwrapped.close()


class CheckedSequence(Sequence):
    """A recording whose declarations and frames are checked as they are read."""

    def __init__(self, sequence: Sequence, who: str) -> None:
        self.unwrapped = sequence
        self._who = who
        stamps = np.asarray(getattr(sequence, "timestamps", ()), np.float64)
        require(stamps.ndim == 1 and len(stamps) > 0, who, "has no frames; check its folder and its options.")
        require(np.isfinite(stamps).all() and np.all(np.diff(stamps) > 0), who, "has time stamps that do not ascend.")
        require(isinstance(getattr(sequence, "camera", None), PinholeCamera), who, "declares no camera.")
        check_name(getattr(sequence, "name", None), who)
        self.name, self.camera, self.timestamps = sequence.name, sequence.camera, stamps
        self.baseline, self.concurrent, self.remarks = sequence.baseline, sequence.concurrent, sequence.remarks
        self.depth_levels_per_metre = sequence.depth_levels_per_metre

    def __getattr__(self, name: str) -> Any:
        if name == "unwrapped":
            raise AttributeError(name)
        return getattr(self.unwrapped, name)

    def __len__(self) -> int:
        return len(self.unwrapped)

    def frame(self, index: int) -> Frame:
        """See ``Sequence.frame``."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        with _named(self._who):
            frame = self.unwrapped.frame(index)
        check_frame(frame, self.camera, self._who)
        return frame

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """See ``Sequence.poses``."""
        poses = self.unwrapped.poses
        if poses is not None:
            fits = poses.shape == (len(self), 4, 4)
            require(fits, self._who, f"gives poses of shape {poses.shape} for {len(self)} frames.")
        return poses

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """See ``Sequence.depth``."""
        depth = self.unwrapped.depth(index)
        if depth is not None:
            check_depth_map(depth, (self.camera.height, self.camera.width), f"{self._who}, frame {index},")
        return depth

    @property
    def fps(self) -> float:
        """See ``Sequence.fps``."""
        return self.unwrapped.fps
