"""Thorough checks for the authors of plug-ins: call them in your own tests.

Each function exercises a plug-in as prgbd does and raises ``ContractError`` with one sentence at the first breach.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from prgbd.core.data import Sequence
from prgbd.core.slam import MODES, GeometricSLAM, TrackingState
from prgbd.core.testing.check import Check
from prgbd.core.testing.passive import CheckedSLAM, check_declarations, with_checks
from prgbd.core.testing.planar_scene import planar_scene
from prgbd.core.testing.refinement_checks import CHECKS
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.core.validation import check_depth_map, check_frame, check_prediction, check_sigma_map, require

if TYPE_CHECKING:
    from prgbd.core.depth import DepthEstimator


def checks_of(kind: str, plugin: Any) -> list[Check]:
    """Return the checks of a plug-in, to be run in order; each works even if one before it has failed.

    Args:
        kind: One of ``prgbd.core.registry.KINDS``.
        plugin: The plug-in, made with ``checks=False``.
    """
    if kind in CHECKS:
        return CHECKS[kind](plugin)
    if kind == "depth":
        return _DepthChecks(plugin, trainable=True).all()
    return _SlamChecks(plugin, None).all() if kind == "slam" else _SequenceChecks(plugin, 5).all()


def check_depth_estimator(estimator: DepthEstimator, *, trainable: bool = True) -> None:
    """Check a depth estimator: shapes, signs, gradients, prediction at image size, determinism, save and load.

    Args:
        estimator: The estimator; its weights come back unchanged.
        trainable: Whether some parameter must receive a gradient.

    Raises:
        ContractError: At the first breach of ``prgbd.DepthEstimator``.
    """
    for check in _DepthChecks(estimator, trainable).all():
        check.run()


def check_sequence(sequence: Sequence, *, frames: int = 5) -> None:
    """Check a recording: sizes, types, time stamps, poses, depth and repeatable reading, on a few frames.

    Args:
        sequence: The recording.
        frames: How many frames, spread over the recording, are read.

    Raises:
        ContractError: At the first breach of ``prgbd.Sequence``.
    """
    for check in _SequenceChecks(sequence, frames).all():
        check.run()


def check_slam(system: GeometricSLAM, *, frames: list[Frame] | None = None) -> SlamResult:
    """Check a SLAM system: order of calls, results, blank and lost frames, repeated use, in every mode it declares.

    Args:
        system: The system.
        frames: Frames with depth (and right images for ``stereo``) of one camera; a small made-up scene by default.

    Returns:
        The last result, for further checks of one's own.

    Raises:
        ContractError: At the first breach of ``prgbd.GeometricSLAM``.
    """
    checks = _SlamChecks(system, frames)
    for check in checks.all():
        check.run()
    require(checks.result is not None, checks.who, "supports no mode that these frames could test.")
    assert checks.result is not None
    return checks.result


class _DepthChecks:
    """The checks of a depth estimator."""

    def __init__(self, estimator: DepthEstimator, trainable: bool) -> None:
        self.estimator, self.trainable = estimator, trainable
        self.who = f"The depth estimator {type(estimator).__name__}"

    def all(self) -> list[Check]:
        checks = [
            Check("declares input_size, depth_range and depth_kind", self._declarations),
            Check("forward: positive, finite depth at the input's size, finest first", self._forward),
            Check("forward: gradients reach the weights and are finite", self._gradients),
            Check("predict: depth at the image's own size, the mode kept, the same twice", self._predict),
            Check("save_weights and load_weights: the same prediction", self._save_and_load),
        ]
        return checks if self.trainable else [check for check in checks if check.run != self._gradients]

    def _images(self) -> Any:
        import torch

        height, width = self.estimator.input_size
        return torch.rand((2, 3, height, width), generator=torch.Generator().manual_seed(0))

    def _declarations(self) -> None:
        from prgbd.core.depth import DepthEstimator

        estimator = self.estimator
        require(isinstance(estimator, DepthEstimator), self.who, "is no subclass of prgbd.DepthEstimator.")
        check_declarations(estimator, self.who)

    def _forward(self) -> None:
        import torch

        images = self._images()
        self.estimator.eval()
        with torch.no_grad():
            prediction = self.estimator(images)
        check_prediction(prediction, images, self.who)
        finest, size = tuple(prediction.depth.shape[2:]), tuple(self.estimator.input_size)
        require(finest == size, self.who, f"predicts its finest depth at {finest}; it must be {size}.")

    def _gradients(self) -> None:
        import torch

        self.estimator.zero_grad()
        sum(depth.log().mean() for depth in self.estimator(self._images()).depths).backward()
        gradients = [p.grad for p in self.estimator.parameters() if p.grad is not None]
        require(any(bool(g.abs().sum() > 0) for g in gradients), self.who, "gives no gradient; is depth detached?")
        finite = all(bool(torch.isfinite(g).all()) for g in gradients)
        require(finite, self.who, "gives gradients that are not finite.")
        self.estimator.zero_grad()

    def _predict(self) -> None:
        estimator, who = self.estimator, self.who
        height, width = estimator.input_size
        size = (height + 17, width + 31)
        image = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
        for training in (False, True):
            estimator.train(training)
            depth = estimator.predict(image)
            check_depth_map(depth, size, f"{who}, in predict,", allow_unknown=False)
            require(estimator.training is training, who, "changes between training and evaluation mode in predict.")
        again = estimator.predict(image)
        same = np.array_equal(depth, again)
        require(same, who, "predicts different depth for the same image; make it deterministic.")
        beside, sigma = estimator.predict_with_sigma(image)
        require(np.array_equal(depth, beside), who, "predicts other depth in predict_with_sigma than in predict.")
        if sigma is not None:
            check_sigma_map(sigma, size, f"{who}, in predict_with_sigma,")
        estimator.eval()

    def _save_and_load(self) -> None:
        import torch

        estimator, images = self.estimator, self._images()
        with tempfile.TemporaryDirectory() as folder, torch.no_grad():
            before = estimator(images)
            estimator.save_weights(Path(folder) / "weights")
            saved = {name: value.clone() for name, value in estimator.state_dict().items()}
            for parameter in estimator.parameters():
                parameter.add_(0.01)
            estimator.load_weights(Path(folder) / "weights")
            after = estimator(images)
            estimator.load_state_dict(saved)
        pairs = [(before.depth, after.depth)]
        if before.sigma is not None:
            pairs.append((before.sigma, after.sigma))
        same = all(torch.allclose(*pair, rtol=1e-4) for pair in pairs)
        require(same, self.who, "predicts otherwise after save_weights and load_weights.")


class _SequenceChecks:
    """The checks of a recording."""

    def __init__(self, sequence: Sequence, frames: int) -> None:
        self.sequence, self.frames = sequence, frames
        self.who = f"The sequence {type(sequence).__name__}"

    def all(self) -> list[Check]:
        return [
            Check("declares a camera, a name safe for files, ascending time stamps", self._declarations),
            Check("frame: RGB uint8 of the camera's size, the same twice", self._frames),
            Check("poses: rigid transforms, one per frame", self._poses),
            Check("depth: float32 metres of the camera's size, 0 where unknown", self._depth),
            Check("frame: IndexError outside of the recording", self._outside),
        ]

    def _checked(self) -> Any:
        return with_checks("data", type(self.sequence).__name__, self.sequence)

    def _chosen(self) -> list[int]:
        return [int(i) for i in np.unique(np.linspace(0, len(self.sequence) - 1, self.frames).astype(int))]

    def _declarations(self) -> None:
        require(isinstance(self.sequence, Sequence), self.who, "is no subclass of prgbd.Sequence.")
        checked, who = self._checked(), self.who
        name = checked.name
        safe = bool(name) and all(c.isalnum() or c in "-_." for c in name)
        require(safe, who, f"is named {name!r}; use letters, digits, '-', '_' and '.' only: files are named for it.")
        require(len(checked) == len(checked.timestamps), who, "has another length than time stamps.")
        require(np.isfinite(checked.fps) and checked.fps > 0, who, f"has a frame rate of {checked.fps}.")

    def _frames(self) -> None:
        checked, who = self._checked(), self.who
        for index in self._chosen():
            frame = checked.frame(index)
            check_frame(frame, checked.camera, who)
            require(frame.index == index, who, f"numbers frame {index} as {frame.index}.")
            require(np.isclose(frame.timestamp, checked.timestamps[index]), who, f"dates frame {index} differently.")
            same = np.array_equal(frame.image, checked.frame(index).image)
            require(same, who, f"reads frame {index} differently the second time.")

    def _poses(self) -> None:
        poses = self._checked().poses
        for index in self._chosen():
            if poses is not None and np.isfinite(poses[index]).all():
                rotation = poses[index, :3, :3]
                rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
                require(rigid, self.who, f"has no rotation at frame {index}.")

    def _depth(self) -> None:
        checked = self._checked()
        for index in self._chosen():
            checked.depth(index)  # the passive checks look at it

    def _outside(self) -> None:
        for outside in (-1, len(self.sequence)):
            try:
                self.sequence.frame(outside)
            except IndexError:
                continue
            count = len(self.sequence)
            require(False, self.who, f"answers frame({outside}) although it has {count} frames; raise IndexError.")


class _SlamChecks:
    """The checks of a SLAM system."""

    def __init__(self, system: GeometricSLAM, frames: list[Frame] | None) -> None:
        self.system, self.given = system, frames
        self.result: SlamResult | None = None
        self.who = f"The SLAM system {type(system).__name__}"

    def all(self) -> list[Check]:
        modes = [mode for mode in sorted(self.system.modes) if mode in MODES]
        if self.given is not None and self.given[0].right is None:
            modes = [mode for mode in modes if mode != "stereo"]
        plain: GeometricSLAM = getattr(self.system, "unwrapped", self.system)  # the passive checks may be around it
        saves = bool(modes) and type(plain).save_map is not GeometricSLAM.save_map
        # Not every scene lets a monocular system start, so the map is made in a mode with depth where there is one.
        maps = sorted(modes, key=lambda mode: mode == "mono")[:1] if saves else []
        return [
            Check("declares its modes", self._declarations),
            *(
                Check(f"{mode}: sound results and views, the same for the same seed", partial(self._mode, mode))
                for mode in modes
            ),
            *(Check("save_map and load_map: frames are found again", partial(self._map, mode)) for mode in maps),
            Check("closes, twice if need be", self._close),
        ]

    def _declarations(self) -> None:
        require(isinstance(self.system, GeometricSLAM), self.who, "is no subclass of prgbd.GeometricSLAM.")
        modes = self.system.modes
        known = bool(modes) and set(modes) <= set(MODES)
        require(known, self.who, f"declares the modes {sorted(modes)}; choose from {', '.join(MODES)}.")

    def _scene(self) -> tuple[PinholeCamera, list[Frame]]:
        frames = self.given if self.given is not None else planar_scene()
        height, width = frames[0].image.shape[:2]
        return PinholeCamera.from_fov(width, height, 60.0), frames

    def _mode(self, mode: str) -> None:
        camera, frames = self._scene()
        checked, who = CheckedSLAM(self.system, self.who), self.who
        first, second = (_run(checked, camera, mode, frames) for _ in range(2))
        same = len(first.trajectory) == len(second.trajectory)
        require(same, who, "gives another result for the same seed.")
        same = np.allclose(first.trajectory.wTc, second.trajectory.wTc, atol=1e-6)
        require(same, who, "gives another trajectory for the same frames and seed; seed everything in reset.")
        self.result = first

    def _map(self, mode: str) -> None:
        camera, frames = self._scene()
        checked = CheckedSLAM(self.system, self.who)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "map"
            _reset(checked, camera, mode)
            tracked = [checked.track(frame).state for frame in frames]
            checked.save_map(path)
            checked.finish()
            if TrackingState.OK not in tracked:
                return  # no map came about that could be loaded
            written = [item for item in Path(folder).rglob("*") if item.is_file()]
            require(written, self.who, "writes no file in save_map.")
            _reset(checked, camera, mode)
            checked.load_map(path)
            found = [checked.track(frame).state for frame in frames]
            checked.finish()
        require(TrackingState.OK in found, self.who, "finds none of the frames again in the map that it saved.")

    def _close(self) -> None:
        self.system.close()
        self.system.close()


def _reset(checked: CheckedSLAM, camera: PinholeCamera, mode: str) -> None:
    checked.reset(camera, mode, baseline=None if mode == "mono" else 0.1, fps=10.0, seed=3)


def _run(checked: CheckedSLAM, camera: PinholeCamera, mode: str, frames: list[Frame]) -> SlamResult:
    _reset(checked, camera, mode)
    for frame in frames:
        checked.track(frame)
        checked.view()
    blank = np.zeros_like(frames[-1].image)
    depth = np.ones(blank.shape[:2], np.float32)
    checked.track(Frame(len(frames), frames[-1].timestamp + 0.1, blank, depth, blank))
    return checked.finish()
