"""What the depth of a network is: ``DepthKind``."""

from __future__ import annotations

from enum import StrEnum


class DepthKind(StrEnum):
    """How far depth may differ from the truth by what a network cannot know.

    Attributes:
        METRIC: Depth is in metres.
        SCALE: Depth is up to a scale.
        AFFINE_DISPARITY: Its inverse is up to a scale and a shift, both unknown and another one in every image:
            ``1 / true depth = a / depth + b`` with ``a > 0`` (MiDaS, the relative models of Depth Anything). Depth is
            positive all the same: whatever maps a disparity to positive numbers by a scale and a shift will do, and
            the farthest depth of an image says no more than that it is far, as the disparity of the sky is 0.
    """

    METRIC = "metric"
    SCALE = "scale"
    AFFINE_DISPARITY = "affine_disparity"
