"""Wrappers of depth estimators in Gymnasium's sense: each is an estimator itself, and they can be put into each other.

``depth.wrappers=[flip_averaged, {clipped: {farthest: 40}}]`` puts them around the network of a run, innermost first.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from prgbd.core.depth import DepthEstimator
from prgbd.core.depth_kind import DepthKind
from prgbd.core.depth_wrapper import DepthWrapper
from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import Count, CountOrZero, NotNegative, Positive
from prgbd.core.options import checked_arguments
from prgbd.core.self_doubting import SelfDoubting
from prgbd.core.types import DepthPrediction


class FlipAveraged(DepthWrapper):
    """Averages the inverse depth of an image and of its mirror image, in evaluation mode (Monodepth, CVPR 2017).

    At the left and right border, where one of the two has no context, the other one counts. Training is left alone.
    """

    def forward(self, images: Tensor) -> DepthPrediction:
        """See ``DepthEstimator.forward``."""
        if self.training:
            return super().forward(images)
        both = super().forward(torch.cat([images, images.flip(3)]))
        depths = tuple(1 / self._blended(1 / depth, len(images)) for depth in both.depths)
        sigma = None if both.sigma is None else self._blended(both.sigma, len(images))
        return DepthPrediction(depths, sigma=sigma)

    @staticmethod
    def _blended(maps: Tensor, count: int) -> Tensor:
        straight, mirrored = maps[:count], maps[count:].flip(3)
        across = torch.linspace(0.0, 1.0, maps.shape[3], device=maps.device, dtype=maps.dtype)
        left = 1 - (20 * (across - 0.05)).clamp(0, 1)  # one at the border, zero after a tenth of the width
        right = left.flip(0)
        # What the mirror image says of the left border, it saw at its right one, and so with all its context.
        return right * straight + left * mirrored + (1 - left - right) * 0.5 * (straight + mirrored)


class Scaled(DepthWrapper):
    """Multiplies depth by a factor, for example the one that makes a network's depth metric.

    Args:
        estimator: The estimator to wrap.
        factor: What depth is multiplied by.
        metric: Whether depth is in metres afterwards; no factor makes that of depth whose inverse lacks a shift.
    """

    def __init__(self, estimator: DepthEstimator, factor: Positive, metric: bool = True) -> None:
        super().__init__(estimator)
        self.factor = factor
        self._scaled_kind = DepthKind.METRIC if metric else DepthKind.SCALE

    @property
    def depth_kind(self) -> DepthKind:  # type: ignore[override]
        """What depth is afterwards."""
        inner = self.estimator.depth_kind
        return inner if inner == DepthKind.AFFINE_DISPARITY else self._scaled_kind

    @property
    def depth_range(self) -> tuple[float, float]:  # type: ignore[override]
        """The inner range times the factor."""
        nearest, farthest = self.estimator.depth_range
        return self.factor * nearest, self.factor * farthest

    def forward(self, images: Tensor) -> DepthPrediction:
        """See ``DepthEstimator.forward``."""
        prediction = super().forward(images)
        return replace(prediction, depths=tuple(self.factor * depth for depth in prediction.depths))

    def extra_repr(self) -> str:
        """What sets it apart from another one."""
        return f"factor={self.factor:g}"


class MedianScaled(DepthWrapper):
    """Scales each image's depth so that its median is the same everywhere, which takes out a scale that flickers.

    Args:
        estimator: The estimator to wrap.
        median: The median that every image gets, in units of depth.
    """

    def __init__(self, estimator: DepthEstimator, median: Positive = 10.0) -> None:
        super().__init__(estimator)
        self.median = median

    @property
    def depth_kind(self) -> DepthKind:  # type: ignore[override]
        """What depth is without its scale."""
        inner = self.estimator.depth_kind
        return inner if inner == DepthKind.AFFINE_DISPARITY else DepthKind.SCALE

    @property
    def depth_range(self) -> tuple[float, float]:  # type: ignore[override]
        """What can come out: the median may lie at either end of the inner range."""
        nearest, farthest = self.estimator.depth_range
        return self.median * nearest / farthest, self.median * farthest / nearest

    def forward(self, images: Tensor) -> DepthPrediction:
        """See ``DepthEstimator.forward``."""
        prediction = super().forward(images)
        # No gradient through the factor: it would belong to one pixel, the median's.
        middle = prediction.depth.detach().flatten(1).median(1).values[:, None, None, None]
        return replace(prediction, depths=tuple(depth * (self.median / middle) for depth in prediction.depths))

    def extra_repr(self) -> str:
        """What sets it apart from another one."""
        return f"median={self.median:g}"


class Clipped(DepthWrapper):
    """Keeps depth within limits, for example the sky from setting the adaptive baseline.

    Args:
        estimator: The estimator to wrap.
        nearest: Nearest depth; None for the network's own.
        farthest: Farthest depth; None for the network's own.

    Raises:
        ConfigError: If nothing lies between the limits.
    """

    def __init__(
        self, estimator: DepthEstimator, nearest: Positive | None = None, farthest: Positive | None = None
    ) -> None:
        super().__init__(estimator)
        near, far = estimator.depth_range
        self.limits = (float(near if nearest is None else nearest), float(far if farthest is None else farthest))
        if not 0 < self.limits[0] < self.limits[1]:
            raise ConfigError(
                f"The depth wrapper clipped keeps nothing between nearest={self.limits[0]:g} and "
                f"farthest={self.limits[1]:g}; change depth.wrappers."
            )

    @property
    def depth_range(self) -> tuple[float, float]:  # type: ignore[override]
        """The limits."""
        return self.limits

    def forward(self, images: Tensor) -> DepthPrediction:
        """See ``DepthEstimator.forward``."""
        prediction = super().forward(images)
        return replace(prediction, depths=tuple(depth.clamp(*self.limits) for depth in prediction.depths))

    def extra_repr(self) -> str:
        """What sets it apart from another one."""
        return f"nearest={self.limits[0]:g}, farthest={self.limits[1]:g}"


class AffineCorrupted(DepthWrapper):
    """Scales and shifts each image's inverse depth at random, as the relative disparity of a network might be.

    ``scale * max(inverse + shift * median, floor)``: what is shifted below the floor, a hundredth of the median, is as
    far as the sky. The draw follows from the seed and the image, so that equal images are corrupted equally, whatever
    the weights. It is for tests and studies of networks of the kind ``affine_disparity``.

    Args:
        estimator: The estimator to wrap.
        scale_sigma: Standard deviation of the logarithm of the scale.
        shift_sigma: Standard deviation of the shift, in medians of the image's inverse depth.
        seed: Of the draws.
    """

    _FLOOR = 0.01

    def __init__(
        self,
        estimator: DepthEstimator,
        scale_sigma: NotNegative = 0.3,
        shift_sigma: NotNegative = 0.3,
        seed: CountOrZero = 0,
    ) -> None:
        super().__init__(estimator)
        self.scale_sigma, self.shift_sigma, self.seed = scale_sigma, shift_sigma, seed

    @property
    def depth_kind(self) -> DepthKind:  # type: ignore[override]
        """Inverse depth up to scale and shift."""
        return DepthKind.AFFINE_DISPARITY

    @property
    def depth_range(self) -> tuple[float, float]:  # type: ignore[override]
        """What comes out but for draws beyond four standard deviations."""
        nearest, farthest = self.estimator.depth_range
        reach = math.exp(4 * self.scale_sigma)
        return nearest / (reach * (1 + 4 * self.shift_sigma)), farthest * reach / self._FLOOR

    def forward(self, images: Tensor) -> DepthPrediction:
        """See ``DepthEstimator.forward``."""
        prediction = super().forward(images)
        drawn = torch.stack([self._drawn(image) for image in images]).to(images.device)
        median = (1 / prediction.depth.detach()).flatten(1).median(1).values[:, None, None, None]
        scale, shift = (drawn[:, i, None, None, None].to(median.dtype) for i in range(2))
        depths = tuple(
            1 / (scale * (1 / d + shift * median).clamp(min=self._FLOOR * median)) for d in prediction.depths
        )
        sigma = None if prediction.sigma is None else prediction.sigma * scale * depths[0] / prediction.depth
        return DepthPrediction(depths, sigma=sigma)

    def _drawn(self, image: Tensor) -> Tensor:
        """Return scale and shift of an image (C, H, W), (2,)."""
        content = zlib.crc32(image.detach().float().cpu().contiguous().numpy().tobytes())
        normal = np.random.default_rng([self.seed, content]).standard_normal(2)
        return torch.tensor([math.exp(self.scale_sigma * normal[0]), self.shift_sigma * normal[1]])

    def extra_repr(self) -> str:
        """What sets it apart from another one."""
        return f"scale_sigma={self.scale_sigma:g}, shift_sigma={self.shift_sigma:g}, seed={self.seed}"


class Cached(DepthWrapper):
    """Remembers the last predictions of single images; changed weights and other images are predicted anew.

    Args:
        estimator: The estimator to wrap.
        size: How many predictions are kept.
    """

    def __init__(self, estimator: DepthEstimator, size: Count = 64) -> None:
        super().__init__(estimator)
        self.size = size
        self._known: OrderedDict[Any, tuple[NDArray[np.float32], NDArray[np.float32] | None]] = OrderedDict()

    def predict(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """See ``DepthEstimator.predict``."""
        return self.predict_with_sigma(image)[0]

    def predict_with_sigma(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """See ``DepthEstimator.predict_with_sigma``."""
        tensors = (*self.parameters(), *self.buffers())
        # A tensor counts the changes that are made to it.
        weights = tuple((t.data_ptr(), t._version) for t in tensors)
        key = (hashlib.sha256(np.ascontiguousarray(image).tobytes()).digest(), image.shape, weights)
        if key not in self._known:
            self._known[key] = self.estimator.predict_with_sigma(image)
            while len(self._known) > self.size:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        depth, sigma = self._known[key]
        return depth.copy(), None if sigma is None else sigma.copy()


WRAPPERS: dict[str, Callable[..., DepthWrapper]] = {
    "flip_averaged": FlipAveraged,
    "scaled": Scaled,
    "median_scaled": MedianScaled,
    "clipped": Clipped,
    "affine_corrupted": AffineCorrupted,
    "cached": Cached,
    "self_doubting": SelfDoubting,
}


def wrap(estimator: DepthEstimator, wrappers: Sequence[str | Mapping[str, Any]]) -> DepthEstimator:
    """Put wrappers around an estimator, the first one innermost.

    Args:
        estimator: The estimator.
        wrappers: Names, or mappings of one name to its options: ``["flip_averaged", {"clipped": {"farthest": 40}}]``.

    Raises:
        ConfigError: If a name or an option is unknown, or a value cannot work.
    """
    for given in wrappers:
        name, options = (given, {}) if isinstance(given, str) else _single(given)
        if name not in WRAPPERS:
            raise ConfigError(f"There is no depth wrapper '{name}'; choose from {', '.join(WRAPPERS)}.")
        given = {**options, "estimator": estimator}
        estimator = WRAPPERS[name](**checked_arguments(WRAPPERS[name], given, f"depth.wrappers.{name}"))
    return estimator


def description(estimator: DepthEstimator) -> list[str]:
    """Return the wrappers of an estimator with their options, outermost first, and what it says of itself, if anything.

    A network says in ``extra_repr`` what sets its prediction apart from another one's of the same weights.
    """
    found = []
    while isinstance(estimator, DepthWrapper):
        found.append(f"{type(estimator).__name__}({estimator.extra_repr()})")
        estimator = estimator.estimator
    own = estimator.extra_repr()
    return [*found, own] if own else found


def _single(given: Any) -> tuple[str, dict[str, Any]]:
    if not isinstance(given, Mapping) or len(given) != 1:
        raise ConfigError(f"'{given}' in depth.wrappers is neither a name nor one name with its options.")
    ((name, options),) = given.items()
    if not isinstance(options or {}, Mapping):
        raise ConfigError(
            f"The options of the depth wrapper {name} must be written {{option: value}}, got {options!r}."
        )
    return str(name), dict(options or {})
