"""Thorough checks for the authors of plug-ins: call them in your own tests.

Each function exercises a plug-in as prgbd does and raises ``ContractError`` with one sentence at the first breach.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prgbd.core.data import Sequence
from prgbd.core.passive import CheckedSLAM, with_checks
from prgbd.core.slam import MODES, GeometricSLAM
from prgbd.core.types import Frame, PinholeCamera, SlamResult
from prgbd.core.validation import check_depth_map, check_frame, check_prediction, require

if TYPE_CHECKING:
    from prgbd.core.depth import DepthEstimator


def check_depth_estimator(estimator: DepthEstimator, *, trainable: bool = True) -> None:
    """Check a depth estimator: shapes, signs, gradients, prediction at image size, determinism, save and load.

    Args:
        estimator: The estimator; its weights come back unchanged.
        trainable: Whether some parameter must receive a gradient.

    Raises:
        ContractError: At the first breach of ``prgbd.DepthEstimator``.
    """
    import torch

    from prgbd.core.depth import DepthEstimator

    who = f"The depth estimator {type(estimator).__name__}"
    require(isinstance(estimator, DepthEstimator), who, "is no subclass of prgbd.DepthEstimator.")
    with_checks("depth", type(estimator).__name__, estimator)
    require(isinstance(estimator.metric, bool), who, f"declares metric={estimator.metric!r}; it must be True or False.")
    height, width = estimator.input_size
    generator = torch.Generator().manual_seed(0)
    images = torch.rand((2, 3, height, width), generator=generator)
    estimator.eval()
    prediction = estimator(images)
    check_prediction(prediction, images, who)
    finest = tuple(prediction.depth.shape[2:])
    require(finest == (height, width), who, f"predicts its finest depth at {finest}; it must be {(height, width)}.")
    if trainable:
        estimator.zero_grad()
        sum(depth.log().mean() for depth in prediction.depths).backward()  # type: ignore[union-attr]
        gradients = [p.grad for p in estimator.parameters() if p.grad is not None]
        require(any(bool(g.abs().sum() > 0) for g in gradients), who, "gives no gradient; is depth detached?")
        require(all(bool(torch.isfinite(g).all()) for g in gradients), who, "gives gradients that are not finite.")
        estimator.zero_grad()
    _check_predict(estimator, who)
    _check_save_and_load(estimator, images, who)


def _check_predict(estimator: DepthEstimator, who: str) -> None:
    height, width = estimator.input_size
    size = (height + 17, width + 31)
    image = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
    for training in (False, True):
        estimator.train(training)
        depth = estimator.predict(image)
        check_depth_map(depth, size, f"{who}, in predict,", allow_unknown=False)
        require(estimator.training is training, who, "changes between training and evaluation mode in predict.")
    again = estimator.predict(image)
    require(np.array_equal(depth, again), who, "predicts different depth for the same image; make it deterministic.")
    estimator.eval()


def _check_save_and_load(estimator: DepthEstimator, images: object, who: str) -> None:
    import torch

    with tempfile.TemporaryDirectory() as folder, torch.no_grad():
        before = estimator(images).depth.clone()
        estimator.save_weights(Path(folder) / "weights")
        saved = {name: value.clone() for name, value in estimator.state_dict().items()}
        for parameter in estimator.parameters():
            parameter.add_(0.01)
        estimator.load_weights(Path(folder) / "weights")
        after = estimator(images).depth
        estimator.load_state_dict(saved)
    require(torch.allclose(before, after, rtol=1e-4), who, "predicts otherwise after save_weights and load_weights.")


def check_sequence(sequence: Sequence, *, frames: int = 5) -> None:
    """Check a recording: sizes, types, time stamps, poses, depth and repeatable reading, on a few frames.

    Args:
        sequence: The recording.
        frames: How many frames, spread over the recording, are read.

    Raises:
        ContractError: At the first breach of ``prgbd.Sequence``.
    """
    who = f"The sequence {type(sequence).__name__}"
    require(isinstance(sequence, Sequence), who, "is no subclass of prgbd.Sequence.")
    checked = with_checks("data", type(sequence).__name__, sequence)
    name = checked.name
    safe = bool(name) and all(c.isalnum() or c in "-_." for c in name)
    require(safe, who, f"is named {name!r}; use letters, digits, '-', '_' and '.' only, since files are named for it.")
    require(len(checked) == len(checked.timestamps), who, "has another length than time stamps.")
    require(np.isfinite(checked.fps) and checked.fps > 0, who, f"has a frame rate of {checked.fps}.")
    poses = checked.poses
    for index in np.unique(np.linspace(0, len(checked) - 1, frames).astype(int)):
        frame = checked.frame(int(index))
        check_frame(frame, checked.camera, who)
        require(frame.index == index, who, f"numbers frame {index} as {frame.index}.")
        require(np.isclose(frame.timestamp, checked.timestamps[index]), who, f"dates frame {index} differently.")
        again = checked.frame(int(index))
        require(np.array_equal(frame.image, again.image), who, f"reads frame {index} differently the second time.")
        checked.depth(int(index))
        if poses is not None and np.isfinite(poses[index]).all():
            rotation = poses[index, :3, :3]
            require(np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3), who, f"has no rotation at frame {index}.")
    for outside in (-1, len(checked)):
        try:
            sequence.frame(outside)
        except IndexError:
            continue
        require(False, who, f"answers frame({outside}) although it has {len(checked)} frames; raise IndexError.")


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
    who = f"The SLAM system {type(system).__name__}"
    require(isinstance(system, GeometricSLAM), who, "is no subclass of prgbd.GeometricSLAM.")
    known = bool(system.modes) and set(system.modes) <= set(MODES)
    require(known, who, f"declares the modes {sorted(system.modes)}; choose from {', '.join(MODES)}.")
    frames = frames if frames is not None else planar_scene()
    height, width = frames[0].image.shape[:2]
    camera = PinholeCamera.from_fov(width, height, 60.0)
    checked = CheckedSLAM(system, who)
    result: SlamResult | None = None
    for mode in sorted(system.modes):
        if mode == "stereo" and frames[0].right is None:
            continue
        runs = [_run(checked, camera, mode, frames) for _ in range(2)]
        require(len(runs[0].trajectory) == len(runs[1].trajectory), who, "gives another result for the same seed.")
        same = np.allclose(runs[0].trajectory.wTc, runs[1].trajectory.wTc, atol=1e-6)
        require(same, who, "gives another trajectory for the same frames and seed; seed everything in reset.")
        result = runs[0]
    checked.close()
    checked.close()
    require(result is not None, who, "supports no mode that these frames could test.")
    assert result is not None
    return result


def _run(checked: CheckedSLAM, camera: PinholeCamera, mode: str, frames: list[Frame]) -> SlamResult:
    checked.reset(camera, mode, baseline=None if mode == "mono" else 0.1, fps=10.0, seed=3)
    for frame in frames:
        checked.track(frame)
    blank = np.zeros_like(frames[-1].image)
    depth = np.ones(blank.shape[:2], np.float32)
    checked.track(Frame(len(frames), frames[-1].timestamp + 0.1, blank, depth, blank))
    return checked.finish()


def planar_scene(count: int = 8, width: int = 320, height: int = 240) -> list[Frame]:
    """Make frames of a camera (60 degrees field of view) that slides along a textured wall 2 m away.

    Args:
        count: Number of frames.
        width: Image width in pixels.
        height: Image height in pixels.

    Returns:
        Frames with exact depth, and right images of a pair with a baseline of 0.1 m.
    """
    import cv2

    rng = np.random.default_rng(0)
    focal, distance, step = PinholeCamera.from_fov(width, height, 60.0).fx, 2.0, 3
    canvas = np.kron(rng.integers(0, 256, (height // 8 + 1, width // 8 + 40, 3), dtype=np.uint8), np.ones((8, 8, 1)))
    canvas = np.asarray(cv2.GaussianBlur(canvas.astype(np.uint8), (5, 5), 1.0))
    shift = round(focal * 0.1 / distance)
    frames = []
    for i in range(count):
        left, right = (canvas[:height, i * step + o : i * step + o + width] for o in (0, shift))
        depth = np.full((height, width), distance, np.float32)
        frames.append(Frame(i, i * 0.1, np.ascontiguousarray(left), depth, np.ascontiguousarray(right)))
    return frames
