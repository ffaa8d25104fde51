"""``DepthWrapper``: an estimator around another one, the base of all wrappers."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from prgbd.core.data import Sequence as Recording
from prgbd.core.depth import DepthEstimator
from prgbd.core.depth_kind import DepthKind
from prgbd.core.sigma_head import SigmaHead
from prgbd.core.types import DepthPrediction, Frame


class DepthWrapper(DepthEstimator):
    """An estimator around another one, which does all of the work unless a subclass does some of it.

    Declarations, pre-processing, pose network and weights are the inner estimator's: weights that are stored through a
    wrapper are read without it, and the other way round.

    Args:
        estimator: The estimator to wrap.
    """

    def __init__(self, estimator: DepthEstimator) -> None:
        super().__init__()
        self.estimator = estimator
        # As it is, so that options of the network's own are found (task.half).
        self.save_weights = estimator.save_weights  # type: ignore[method-assign]

    @property
    def input_size(self) -> tuple[int, int]:  # type: ignore[override]
        """See ``DepthEstimator``."""
        return self.estimator.input_size

    @property
    def depth_range(self) -> tuple[float, float]:  # type: ignore[override]
        """See ``DepthEstimator``."""
        return self.estimator.depth_range

    @property
    def depth_kind(self) -> DepthKind:  # type: ignore[override]
        """See ``DepthEstimator``."""
        return self.estimator.depth_kind

    @property
    def unwrapped(self) -> DepthEstimator:
        """The innermost estimator."""
        inner = self.estimator
        return inner.unwrapped if isinstance(inner, DepthWrapper) else inner

    def forward(self, images: Tensor) -> DepthPrediction:
        """See ``DepthEstimator.forward``."""
        prediction: DepthPrediction = self.estimator(images)
        return prediction

    @contextlib.contextmanager
    def finest_scale(self) -> Iterator[None]:
        """See ``DepthEstimator.finest_scale``."""
        with super().finest_scale(), self.estimator.finest_scale():
            yield

    def preprocess(self, image: NDArray[np.uint8]) -> Tensor:
        """See ``DepthEstimator.preprocess``."""
        return self.estimator.preprocess(image)

    def observe(self, sequence: Recording, frame: Frame) -> Tensor:
        """See ``DepthEstimator.observe``."""
        return self.estimator.observe(sequence, frame)

    def sigma_head(self) -> SigmaHead | None:
        """See ``DepthEstimator.sigma_head``."""
        return self.estimator.sigma_head()

    def sigma_features(self, images: Tensor) -> Sequence[Tensor]:
        """See ``DepthEstimator.sigma_features``."""
        return self.estimator.sigma_features(images)

    def pose_network(self) -> nn.Module | None:
        """See ``DepthEstimator.pose_network``."""
        return self.estimator.pose_network()

    def load_weights(self, folder: Path) -> None:
        """See ``DepthEstimator.load_weights``."""
        self.estimator.load_weights(folder)
