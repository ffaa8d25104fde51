"""What must hold of the values that cross an interface; each function raises a one-sentence ``ContractError``.

Used by the passive checks, which run with every plug-in, and by the conformance checks of plug-in authors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from prgbd.core.errors import ContractError
from prgbd.core.refinement_batch import RefinementBatch
from prgbd.core.slam import SlamView, TrackingResult, TrackingState
from prgbd.core.types import DepthPrediction, Frame, PinholeCamera, SlamResult

if TYPE_CHECKING:
    from torch import Tensor

LONGEST_NAME = 180
"""Bytes of the name of a recording: most file systems take 255, of which names of temporary files need some."""


def require(condition: Any, who: str, what: str) -> None:
    """Raise ``ContractError`` with ``who`` and ``what`` unless the condition holds."""
    if not condition:
        raise ContractError(f"{who} {what}")


def check_name(name: Any, who: str) -> None:
    """Require the name of a recording to be one that a file can have: its results lie in folders of that name."""
    require(isinstance(name, str), who, f"is named {name!r}; a name is a text.")
    # Readers of run folders leave hidden files out, and no part of a path may lead elsewhere.
    plain = name.strip() and not name.startswith(".") and name.isprintable() and not set(name) & {"/", "\\"}
    require(plain, who, f"is named {name!r}, which no file can be; leave out slashes and a dot in front.")
    length = len(name.encode(errors="replace"))
    require(length <= LONGEST_NAME, who, f"has a name of {length} bytes; {LONGEST_NAME} is the most that files allow.")


def check_pose(wTc: Any, who: str) -> None:
    """Require a finite 4x4 rigid transform."""
    pose = np.asarray(wTc)
    require(pose.shape == (4, 4), who, f"gave a pose of shape {pose.shape}; it must be (4, 4).")
    require(np.isfinite(pose).all(), who, "gave a pose that is not finite; return None for a frame without a pose.")
    rotation = pose[:3, :3]
    orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0
    require(
        orthonormal and np.allclose(pose[3], [0, 0, 0, 1]),
        who,
        "gave a pose that is no rigid transform; its rotation must be orthonormal and its last row 0 0 0 1.",
    )


def check_poses(wTc: Any, frame_index: Any, who: str) -> None:
    """Require finite (N, 4, 4) poses to be rigid transforms; the first that is none is named by its frame."""
    rotation = wTc[:, :3, :3]
    skewed = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max((1, 2), initial=0.0) > 1e-4
    skewed |= (np.linalg.det(rotation) < 0) | (np.abs(wTc[:, 3] - [0, 0, 0, 1]).max(1, initial=0.0) > 1e-8)
    if skewed.any():
        first = int(np.argmax(skewed))
        check_pose(wTc[first], f"{who}, frame {frame_index[first]},")


def check_depth_shape(depth: Any, shape: tuple[int, int], who: str) -> None:
    """Require an (H, W) float32 array, whatever is in it."""
    require(
        isinstance(depth, np.ndarray) and depth.shape == shape,
        who,
        f"gave depth of shape {getattr(depth, 'shape', type(depth).__name__)}; it must be {shape} like the image.",
    )
    require(depth.dtype == np.float32, who, f"gave depth as {depth.dtype}; it must be float32 metres.")


def check_depth_map(depth: Any, shape: tuple[int, int], who: str, *, allow_unknown: bool = True) -> None:
    """Require an (H, W) float32 map of finite depth, with 0 for unknown if that is allowed."""
    check_depth_shape(depth, shape, who)
    bad = int(np.count_nonzero(~np.isfinite(depth)))
    require(bad == 0, who, f"gave {bad} depth values that are NaN or infinite; mark unknown depth with 0.")
    lowest = float(depth.min()) if depth.size else 0.0
    require(lowest >= 0 if allow_unknown else lowest > 0, who, f"gave a depth of {lowest:g}; depth must be positive.")


def check_sigma_map(sigma: Any, shape: tuple[int, int], who: str) -> None:
    """Require an (H, W) float32 map of positive, finite standard deviations of log depth."""
    found = f"{sigma.shape} {sigma.dtype}" if isinstance(sigma, np.ndarray) else type(sigma).__name__
    fits = isinstance(sigma, np.ndarray) and sigma.shape == shape and sigma.dtype == np.float32
    require(fits, who, f"gave the deviation of depth as {found}; it must be {shape} float32 like the depth.")
    fine = bool(((sigma > 0) & (sigma < np.inf)).all())
    require(fine, who, "gave deviations of depth that are zero, negative, NaN or infinite; they must be positive.")


def check_image(image: Any, who: str) -> None:
    """Require an (H, W, 3) uint8 image; a gray one, or one of numbers up to 1, would give nonsense further on."""
    fits = isinstance(image, np.ndarray) and image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8
    found = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
    require(fits, who, f"takes an image (H, W, 3) of uint8 RGB, not {found}.")


def check_frame(frame: Any, camera: PinholeCamera, who: str) -> None:
    """Require an RGB uint8 image, and depth and right image, of the camera's size."""
    require(isinstance(frame, Frame), who, f"gave a {type(frame).__name__} where a prgbd.Frame belongs.")
    shape = (camera.height, camera.width)
    here = f"{who}, frame {frame.index},"
    for name, image in (("image", frame.image), ("right image", frame.right)):
        if image is None and name == "right image":
            continue
        fits = isinstance(image, np.ndarray) and image.shape == (*shape, 3) and image.dtype == np.uint8
        found = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
        require(fits, here, f"gave the {name} as {found}; the camera asks for {(*shape, 3)} uint8 RGB.")
    dated = isinstance(frame.timestamp, (int, float, np.number)) and np.isfinite(frame.timestamp)
    require(dated, here, f"gave the time stamp {frame.timestamp}; it must be seconds, a finite number.")
    if frame.depth is not None:
        check_depth_map(frame.depth, shape, here)
    if frame.depth_sigma is not None:
        check_sigma_map(frame.depth_sigma, shape, here)


def check_prediction(prediction: Any, images: Tensor, who: str) -> None:
    """Require a ``DepthPrediction`` of positive, finite maps, finest first, for a (B, 3, H, W) batch."""
    import torch

    require(
        isinstance(prediction, DepthPrediction) and len(prediction.depths) > 0,
        who,
        f"returned a {type(prediction).__name__} from forward; it must be a prgbd.DepthPrediction with depth maps.",
    )
    widths = []
    for depth in prediction.depths:
        real = isinstance(depth, torch.Tensor) and depth.is_floating_point()
        found = getattr(depth, "dtype", type(depth).__name__)
        require(real, who, f"returned depth as {found} from forward; it must be a torch tensor of floating point.")
        shape = tuple(depth.shape)
        require(
            len(shape) == 4 and shape[0] == images.shape[0] and shape[1] == 1,
            who,
            f"returned depth of shape {shape}; it must be ({images.shape[0]}, 1, H, W).",
        )
        # One reduction for both conditions: NaN and infinity fail the comparisons as well.
        fine = bool(((depth.detach() > 0) & (depth.detach() < torch.inf)).all())
        require(fine, who, "returned depth that is zero, negative, NaN or infinite; depth must be positive and finite.")
        widths.append(shape[3])
    require(widths == sorted(widths, reverse=True), who, f"returned scales of widths {widths}; put the finest first.")
    if prediction.sigma is not None:
        _check_sigma(prediction.sigma, tuple(prediction.depth.shape), who)


def _check_sigma(sigma: Any, shape: tuple[int, ...], who: str) -> None:
    """Require the deviation of a prediction to fit its finest depth."""
    import torch

    real = isinstance(sigma, torch.Tensor) and sigma.is_floating_point() and tuple(sigma.shape) == shape
    found = f"{tuple(sigma.shape)} {sigma.dtype}" if isinstance(sigma, torch.Tensor) else type(sigma).__name__
    require(real, who, f"returned sigma as {found}; it must be floating point of shape {shape} like the finest depth.")
    fine = bool(((sigma.detach() > 0) & (sigma.detach() < torch.inf)).all())
    require(fine, who, "returned a sigma that is zero, negative, NaN or infinite; it must be positive and finite.")


def check_tracking_result(result: Any, who: str) -> None:
    """Require a ``TrackingResult`` whose pose fits its state."""
    require(
        isinstance(result, TrackingResult) and isinstance(result.state, TrackingState),
        who,
        f"returned a {type(result).__name__} from track; it must be a prgbd.TrackingResult with a TrackingState.",
    )
    if result.state is TrackingState.OK:
        require(result.wTc is not None, who, "says a frame is tracked but gives no pose.")
    if result.wTc is not None:
        check_pose(result.wTc, who)


def check_view(view: Any, who: str) -> None:
    """Require a ``SlamView`` whose columns have the documented shapes, or None."""
    if view is None:
        return
    require(isinstance(view, SlamView), who, f"returned a {type(view).__name__} from view; it must be a SlamView.")
    for name, tail in (("keyframes", (4, 4)), ("points", (3,)), ("rgb", (3,)), ("keypoints", (2,))):
        shape = np.shape(getattr(view, name))
        columns = ", ".join(map(str, ("N", *tail)))
        require(shape[1:] == tail and shape, who, f"gives a view whose {name} have shape {shape}, not ({columns}).")
    count, colours = len(view.points), len(view.rgb)
    require(count == colours, who, f"gives a view of {count} points with {colours} colours.")


def check_slam_result(result: Any, frames: int, who: str) -> None:
    """Require a ``SlamResult`` whose columns agree with each other and with the number of frames."""
    require(isinstance(result, SlamResult), who, f"returned a {type(result).__name__} from finish, not a SlamResult.")
    require(result.frames == frames, who, f"counts {result.frames} frames but was given {frames}.")
    require(
        len(result.states) == frames and len(result.inliers) == frames,
        who,
        f"reports {len(result.states)} states and {len(result.inliers)} inlier counts for {frames} frames.",
    )
    trajectory, keyframes, observations = result.trajectory, result.keyframes, result.observations
    n = len(trajectory)
    require(
        trajectory.wTc.shape == (n, 4, 4) and np.isfinite(trajectory.wTc).all(),
        who,
        "gives a trajectory with poses that are not finite (N, 4, 4).",
    )
    require(np.all(np.diff(trajectory.frame_index) > 0), who, "gives a trajectory whose frames do not ascend.")
    check_poses(trajectory.wTc, trajectory.frame_index, who)
    require(np.isfinite(result.points.xyz).all(), who, "gives map points that are not finite.")
    m = len(observations)
    if m:
        inside = observations.keyframe.min() >= 0 and observations.keyframe.max() < len(keyframes)
        inside = inside and observations.point.min() >= 0 and observations.point.max() < len(result.points)
        require(inside, who, "gives observations of keyframes or points that do not exist.")
        require(observations.uv.shape == (m, 2) and observations.depth.shape == (m,), who, "gives ragged observations.")


def check_loss_value(value: Any, who: str) -> None:
    """Require the value of a loss term to be a scalar tensor of floating point; it may be infinite or NaN."""
    import torch

    floating = isinstance(value, torch.Tensor) and value.is_floating_point()
    require(floating, who, f"gave a {type(value).__name__} where a tensor of floating point belongs.")
    require(value.ndim == 0, who, f"gave a tensor of shape {tuple(value.shape)}; reduce it to a scalar.")


def check_augmented(batch: Any, before: RefinementBatch, who: str) -> None:
    """Require an augmented batch to have the shapes and types of the one before."""
    kind = type(batch).__name__
    require(isinstance(batch, RefinementBatch), who, f"gave a {kind} where a prgbd.RefinementBatch belongs.")
    for name, value in before._replace(altered=before.images)._asdict().items():
        given = batch.inputs if name == "altered" else getattr(batch, name)
        same = tuple(given.shape) == tuple(value.shape) and given.dtype == value.dtype
        wanted = f"it must stay {tuple(value.shape)} {value.dtype}"
        require(same, who, f"gave '{name}' of shape {tuple(given.shape)} {given.dtype}; {wanted}.")
