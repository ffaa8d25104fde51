"""How far predicted depth is from the truth: the seven standard metrics and the Monodepth2 protocol around them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from collections.abc import Sequence as Seq
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.data import Sequence
from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import ConfigError, ContractError

if TYPE_CHECKING:
    from prgbd.core.depth import DepthEstimator

METRICS = ("abs_rel", "sq_rel", "rmse", "rmse_log", "a1", "a2", "a3")
DEFAULT_CAP = (1e-3, 80.0)
# Rows and columns that count, as fractions of the image: top, bottom, left, right.
CROPS = {
    "none": (0.0, 1.0, 0.0, 1.0),
    "garg": (0.40810811, 0.99189189, 0.03594771, 0.96405229),
    "eigen": (0.3324324, 0.91351351, 0.0359477, 0.96405229),
}


def depth_metrics(gt: NDArray[np.floating[Any]], pred: NDArray[np.floating[Any]]) -> dict[str, float]:
    """Compute the seven metrics of Eigen et al. over valid pixels.

    Args:
        gt: True depth, any shape, positive.
        pred: Predicted depth of the same shape, positive, in the same scale.

    Returns:
        ``abs_rel``, ``sq_rel``, ``rmse``, ``rmse_log`` (errors) and ``a1``, ``a2``, ``a3`` (fractions of pixels whose
        ratio to the truth is below 1.25, 1.25^2, 1.25^3).
    """
    gt, pred = np.asarray(gt, np.float64), np.asarray(pred, np.float64)
    ratio = np.maximum(gt / pred, pred / gt)
    difference = gt - pred
    return {
        "abs_rel": float(np.mean(np.abs(difference) / gt)),
        "sq_rel": float(np.mean(difference**2 / gt)),
        "rmse": float(np.sqrt(np.mean(difference**2))),
        "rmse_log": float(np.sqrt(np.mean((np.log(gt) - np.log(pred)) ** 2))),
        "a1": float(np.mean(ratio < 1.25)),
        "a2": float(np.mean(ratio < 1.25**2)),
        "a3": float(np.mean(ratio < 1.25**3)),
    }


def evaluation_mask(gt: NDArray[np.float32], cap: tuple[float, float], crop: str) -> NDArray[np.bool_]:
    """Return which pixels count: true depth strictly within ``cap`` metres and inside the crop, (H, W) bool.

    Raises:
        ConfigError: If the crop is unknown or the cap is empty.
    """
    if crop not in CROPS:
        raise ConfigError(f"There is no depth crop '{crop}'; choose one of {', '.join(CROPS)}.")
    if not 0 <= cap[0] < cap[1]:
        raise ConfigError(f"The depth cap must be (nearest, farthest) with 0 <= nearest < farthest, got {tuple(cap)}.")
    height, width = gt.shape
    top, bottom, left, right = CROPS[crop]
    mask = np.zeros(gt.shape, bool)
    inside = np.s_[int(top * height) : int(bottom * height), int(left * width) : int(right * width)]
    mask[inside] = (gt[inside] > cap[0]) & (gt[inside] < cap[1])
    return mask


def align_depth(
    gt: NDArray[np.float32],
    pred: NDArray[np.float32],
    cap: tuple[float, float] = DEFAULT_CAP,
    crop: str = "none",
    median_scaling: bool = True,
    affine: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float] | None:
    """Select the pixels that count and bring the prediction to the truth's scale, as Monodepth2's evaluation does.

    Args:
        gt: (H, W) true depth in metres, 0 where unknown.
        pred: (H, W) predicted depth; another size is resized to the truth's as inverse depth.
        cap: (nearest, farthest) metres; truth outside is ignored, predictions are clamped to it.
        crop: ``none``, ``garg`` or ``eigen``.
        median_scaling: Whether to multiply the prediction by median(truth) / median(prediction).
        affine: Instead, give the inverse of the prediction the scale and the shift that bring it nearest to the inverse
            of the truth, by least squares, as MiDaS is evaluated (Ranftl et al., TPAMI 2022).

    Returns:
        ``(truth, prediction, ratio)``: the two as vectors, and the ratio of the medians whether it was applied or not.
        None if no pixel counts.

    Raises:
        ContractError: If the prediction is not finite or not positive where the truth is known.
        ConfigError: If the crop or cap is wrong.
    """
    mask = evaluation_mask(gt, cap, crop)
    if not mask.any():
        return None
    if pred.shape != gt.shape:
        import cv2

        inverse = cv2.resize(1.0 / pred, (gt.shape[1], gt.shape[0]), interpolation=cv2.INTER_LINEAR)
        pred = (1.0 / inverse).astype(np.float32)
    truth, prediction = gt[mask].astype(np.float64), pred[mask].astype(np.float64)
    if not (np.isfinite(prediction).all() and (prediction > 0).all()):
        raise ContractError(
            "The predicted depth has values that are zero, negative, NaN or infinite; mend the network."
        )
    ratio = float(np.median(truth) / np.median(prediction))
    if affine:
        prediction = _fitted(truth, prediction, cap[1])
    elif median_scaling:
        prediction = prediction * ratio
    return truth, np.clip(prediction, *cap), ratio


def _fitted(truth: NDArray[np.float64], prediction: NDArray[np.float64], farthest: float) -> NDArray[np.float64]:
    """Align inverse depths (N,) by scale and shift; what would lie behind the camera is the farthest."""
    design = np.stack([1.0 / prediction, np.ones_like(prediction)], axis=1)
    inverse = design @ np.linalg.lstsq(design, 1.0 / truth, rcond=None)[0]
    return np.asarray(1.0 / np.maximum(inverse, 1.0 / farthest))


def evaluate_depth_image(
    gt: NDArray[np.float32],
    pred: NDArray[np.float32],
    cap: tuple[float, float] = DEFAULT_CAP,
    crop: str = "none",
    median_scaling: bool = True,
    affine: bool = False,
) -> dict[str, float] | None:
    """Evaluate one image; see ``align_depth`` for the arguments and errors.

    Returns:
        The seven metrics, ``scale`` (ratio of the medians) and ``pixels``; None if no pixel counts.
    """
    aligned = align_depth(gt, pred, cap, crop, median_scaling, affine)
    if aligned is None:
        return None
    truth, prediction, ratio = aligned
    return {**depth_metrics(truth, prediction), "scale": ratio, "pixels": len(truth)}


class DepthEvaluation:
    """Collects images one by one and gives the means; nothing but a few numbers per image is kept.

    Args:
        cap: (nearest, farthest) metres of the headline figures.
        crop: ``none``, ``garg`` or ``eigen``.
        median_scaling: Per-image median scaling.
        caps: Further farthest depths to evaluate for, each by the full protocol (the paper: 30, 40, ... 80 m).
        bins: Ascending depths in metres; errors are also collected for the truth between each two of them.
        affine: Per-image scale and shift of inverse depth in place of median scaling.
    """

    def __init__(
        self,
        cap: tuple[float, float] = DEFAULT_CAP,
        crop: str = "none",
        median_scaling: bool = True,
        caps: Seq[float] = (),
        bins: Seq[float] = (),
        affine: bool = False,
    ) -> None:
        if len(bins) == 1 or np.any(np.diff(bins) <= 0):
            raise ConfigError(f"The depth bins must be at least two ascending depths in metres, got {list(bins)}.")
        self.cap, self.crop, self.median_scaling = (float(cap[0]), float(cap[1])), crop, median_scaling
        self.affine = affine
        self._images: dict[float, list[dict[str, float]]] = {self.cap[1]: [], **{float(c): [] for c in caps}}
        self._caps = [float(c) for c in caps]
        self._bins = np.asarray(bins, np.float64)
        self._bin_sums = np.zeros((4, max(0, len(bins) - 1)))  # pixels, sum |d|/gt, sum d^2, sum d^2/gt
        self._halves = np.array([self.cap[0], self.cap[1] / 2, self.cap[1]])
        self._half_sums = np.zeros((4, 2))
        self._seen = 0

    def add(self, gt: NDArray[np.float32], pred: NDArray[np.float32]) -> dict[str, float] | None:
        """Take in one image, (H, W) truth with 0 for unknown and (H, W) prediction; return its headline figures."""
        self._seen += 1
        headline = None
        for farthest, images in self._images.items():
            aligned = align_depth(gt, pred, (self.cap[0], farthest), self.crop, self.median_scaling, self.affine)
            if aligned is None:
                continue
            truth, prediction, ratio = aligned
            images.append({**depth_metrics(truth, prediction), "scale": ratio})
            if farthest == self.cap[1]:
                headline = images[-1]
                self._bin_sums += _sums_by_depth(truth, prediction, self._bins)
                self._half_sums += _sums_by_depth(truth, prediction, self._halves)
        return headline

    def skip(self) -> None:
        """Count an image that has no true depth."""
        self._seen += 1

    def result(self) -> dict[str, Any]:
        """Return the means over images as plain numbers (keys: docs/summary-schema.md)."""
        images = self._images[self.cap[1]]
        out: dict[str, Any] = {name: _mean(images, name) for name in METRICS}
        scales = np.array([image["scale"] for image in images])
        middle = float(np.median(scales)) if len(scales) else None
        out |= {
            "cap": list(self.cap),
            "crop": self.crop,
            "images": len(images),
            "images_without_truth": self._seen - len(images),
            "median_scaling": self.median_scaling and not self.affine,
            "scale_and_shift": self.affine,
            "scale_median": middle,
            "scale_std": float(np.std(scales / middle)) if middle else None,
            "reason": None if images else "No image has true depth within the cap.",
        }
        if self._caps:
            out["by_cap"] = [
                {"cap": cap, "images": len(self._images[cap])} | {n: _mean(self._images[cap], n) for n in METRICS}
                for cap in self._caps
            ]
        if len(self._bins):
            out["by_depth"] = _by_depth(self._bins, self._bin_sums)
        # Both halves of the cap under the one scale of each image: a gain of the far half is not a change of scale.
        out["near"], out["far"] = _by_depth(self._halves, self._half_sums)
        return out


def _sums_by_depth(
    truth: NDArray[np.float64], prediction: NDArray[np.float64], edges: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sum up the errors of aligned pixels by their true depth.

    Returns:
        (4, len(edges) - 1): pixels and the sums of |d| / gt, d^2 and d^2 / gt; (4, 0) without edges.
    """
    if not len(edges):
        return np.zeros((4, 0))
    inside = (truth >= edges[0]) & (truth <= edges[-1])
    truth, difference = truth[inside], (truth - prediction)[inside]
    # As in np.histogram, the last range includes its end; four histograms would sort the pixels four times.
    bins = np.minimum(np.searchsorted(edges, truth, side="right") - 1, len(edges) - 2)
    rows = (None, np.abs(difference) / truth, difference**2, difference**2 / truth)
    return np.stack([np.bincount(bins, weights, minlength=len(edges) - 1).astype(np.float64) for weights in rows])


def _by_depth(edges: NDArray[np.float64], sums: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Turn the sums of ``_sums_by_depth`` into errors, one entry per range of depth."""
    entries = []
    for i, (pixels, relative, squared, squared_relative) in enumerate(sums.T):
        entries.append(
            {
                "from": float(edges[i]),
                "to": float(edges[i + 1]),
                "pixels": int(pixels),
                "abs_rel": float(relative / pixels) if pixels else None,
                "sq_rel": float(squared_relative / pixels) if pixels else None,
                "rmse": float(np.sqrt(squared / pixels)) if pixels else None,
            }
        )
    return entries


def _mean(images: list[dict[str, float]], name: str) -> float | None:
    return float(np.mean([image[name] for image in images])) if images else None


def evaluate_depth(
    estimator: DepthEstimator | Callable[[NDArray[np.uint8]], NDArray[np.float32]],
    sequence: Sequence,
    indices: Iterable[int] | None = None,
    *,
    cap: tuple[float, float] = DEFAULT_CAP,
    crop: str = "none",
    median_scaling: bool = True,
    caps: Seq[float] = (),
    bins: Seq[float] = (),
) -> dict[str, Any]:
    """Evaluate a depth network on frames of a sequence that has true depth.

    Args:
        estimator: A ``DepthEstimator``, or a function from an (H, W, 3) uint8 image to (H, W) depth.
        sequence: The recording; frames without true depth are left out and counted.
        indices: Frames to evaluate; all by default.
        cap: (nearest, farthest) metres.
        crop: ``none``, ``garg`` or ``eigen``.
        median_scaling: Whether each prediction is scaled by the ratio of medians. Predictions of a network of the kind
            ``affine_disparity`` are aligned by scale and shift of inverse depth in any case.
        caps: Further farthest depths, evaluated on the same predictions.
        bins: Ascending depths in metres for the errors by depth.

    Returns:
        The means over images and the protocol (keys: docs/summary-schema.md). Without any true depth the figures are
        None and ``reason`` says so.

    Raises:
        ContractError: If a prediction is not finite and positive.
    """
    predict = estimator.predict if hasattr(estimator, "predict") else estimator
    affine = getattr(estimator, "depth_kind", None) == DepthKind.AFFINE_DISPARITY
    evaluation = DepthEvaluation(cap, crop, median_scaling, caps, bins, affine)
    for index in range(len(sequence)) if indices is None else indices:
        gt = sequence.depth(int(index))
        if gt is None:
            evaluation.skip()
        else:
            evaluation.add(gt, predict(sequence.frame(int(index)).image))
    return evaluation.result()
