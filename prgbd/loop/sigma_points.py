"""What SLAM's points say of a network's error: log depth at keypoints beside triangulated depth, image by image."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from prgbd.core.data import Sequence
from prgbd.core.depth import DepthEstimator
from prgbd.core.multiview import rows_by_group
from prgbd.core.types import SlamResult, resize_pixels
from prgbd.core.undistortion import Undistorter
from prgbd.evaluation.triangulated_depth import triangulated_observations
from prgbd.functional.sparse_losses import sample_patches
from prgbd.training.supervision import clean_observations

_FEWEST_POINTS = 20  # fewer do not tell the scale of an image
_MOST_POINTS = 40_000  # some 200 MB of features at 240 a point and half a dozen copies


@dataclass(frozen=True)
class SigmaPoints:
    """Points of SLAM beside what a network predicts there.

    Attributes:
        frame: (N,) int64, the frame of each.
        errors: (N,) float64 absolute errors of log depth, after the median error of the image is taken out.
        sigma: (N,) float64 predicted standard deviation of log depth; None where the network predicts none.
        features: (N, C) float32 what the network's head predicts it from; None where it has no head.
    """

    frame: NDArray[np.int64]
    errors: NDArray[np.float64]
    sigma: NDArray[np.float64] | None = None
    features: Tensor | None = None

    def __len__(self) -> int:
        return len(self.frame)

    def of(self, frames: Iterable[int]) -> SigmaPoints:
        """Return the points of some frames."""
        rows = np.flatnonzero(np.isin(self.frame, np.fromiter(frames, np.int64)))
        return SigmaPoints(
            self.frame[rows],
            self.errors[rows],
            None if self.sigma is None else self.sigma[rows],
            None if self.features is None else self.features[torch.from_numpy(rows)],
        )


def sigma_points(
    estimator: DepthEstimator, sequence: Sequence, result: SlamResult, *, features: bool, most: int = _MOST_POINTS
) -> SigmaPoints:
    """Predict the keyframes of a SLAM run and compare with the points that they see.

    Triangulation takes poses and pixels alone, so a map that follows the network's depth does not make it look good.

    Args:
        estimator: The network, in evaluation mode afterwards as before.
        sequence: The recording.
        result: What SLAM made of it.
        features: Whether the features of the network's head are wanted, if it has one.
        most: Points at most, an equal share of every keyframe.
    """
    seen = clean_observations(result)
    rows, depth = triangulated_observations(result, seen)
    groups = rows_by_group(seen.keyframe[rows], _FEWEST_POINTS)
    share = max(_FEWEST_POINTS, most // max(len(groups), 1))
    lens = Undistorter(result.camera)
    found: list[SigmaPoints] = []
    was_training = estimator.training
    estimator.eval()
    try:
        for group in groups:
            chosen = group[np.unique(np.linspace(0, len(group) - 1, min(share, len(group))).astype(int))]
            frame = int(result.keyframes.frame_index[seen.keyframe[rows[group[0]]]])
            image = estimator.preprocess(lens.image(sequence.frame(frame).image))
            found.append(_at(estimator, image, frame, seen.uv[rows[chosen]], depth[chosen], result, features))
    finally:
        estimator.train(was_training)
    return joined(found)


def _at(
    estimator: DepthEstimator,
    image: Tensor,
    frame: int,
    uv: NDArray[np.float32],
    depth: NDArray[np.float64],
    result: SlamResult,
    features: bool,
) -> SigmaPoints:
    """Compare one image at the pixels of its points."""
    device = next((p.device for p in estimator.parameters()), torch.device("cpu"))
    images = image[None].to(device)
    camera, head = result.camera, estimator.sigma_head()
    with torch.no_grad(), estimator.finest_scale():
        prediction = estimator(images)
        height, width = prediction.depth.shape[-2:]
        size = np.array([width / camera.width, height / camera.height])
        pixels = torch.from_numpy(np.asarray(resize_pixels(uv.astype(np.float64), size), np.float32))[None].to(device)
        predicted = sample_patches(prediction.depth.float(), pixels, 1).depth[0, :, 0].cpu().numpy()
        sigma = None
        if prediction.sigma is not None:
            sigma = sample_patches(prediction.sigma.float(), pixels, 1).depth[0, :, 0].double().cpu().numpy()
        sampled = None
        if features and head is not None:
            sampled = head.sampled(estimator.sigma_features(images), pixels)[0].cpu()
    error = np.log(predicted.astype(np.float64) / depth)
    return SigmaPoints(np.full(len(uv), frame), np.abs(error - np.median(error)), sigma, sampled)


def joined(parts: Many[SigmaPoints]) -> SigmaPoints:
    """Put points together."""
    if not parts:
        return SigmaPoints(np.zeros(0, np.int64), np.zeros(0))
    sigmas = [part.sigma for part in parts if part.sigma is not None]
    features = [part.features for part in parts if part.features is not None]
    return SigmaPoints(
        np.concatenate([part.frame for part in parts]),
        np.concatenate([part.errors for part in parts]),
        np.concatenate(sigmas) if sigmas else None,
        torch.cat(features) if features else None,
    )
