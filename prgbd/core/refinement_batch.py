"""``RefinementBatch``: what a step of the depth refinement learns from, as loss terms and augmentations get it."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

from prgbd.core.types import resize_pixels

if TYPE_CHECKING:
    from torch import Tensor


class View(IntEnum):
    """The images of a sample, by their place in ``RefinementBatch.images``."""

    CURRENT = 0
    """The keyframe c itself."""
    BEFORE = 1
    """The frame before it in time (c - ``training.frame_gap``)."""
    AFTER = 2
    """The frame after it."""
    KEYFRAME_1 = 3
    """The neighbouring keyframe k1, earlier in time."""
    KEYFRAME_2 = 4
    """The neighbouring keyframe k2, later in time."""


class RefinementBatch(NamedTuple):
    """A batch of keyframes with their neighbours; a single sample is the same without the first axis.

    Lengths are in the unit of the network's depth.

    Attributes:
        images: (B, 5, 3, H, W) uint8, or float in [0, 1] once on the device: c, c-1, c+1, k1, k2 (see ``View``).
        K: (B, 3, 3) float32 intrinsics at the size of the images, pixels.
        aTc: (B, 2, 4, 4) float32 from c to the adjacent frames.
        kTc: (B, 2, 4, 4) float32 from c to k1 and k2.
        uv: (B, 3, N, 2) float32 keypoints in c, k1 and k2, pixels of the images.
        depth: (B, 3, N) float32 depth by SLAM in c, k1 and k2.
        mask: (B, N) bool, real points; the rest is padding.
        seen_uv: (B, M, 2) float32 the points that teach c's own depth, pixels of the images.
        seen_depth: (B, M) float32 their depth by SLAM in c.
        seen_mask: (B, M) bool, the real ones.
        altered: (B, 5, 3, H, W) what the network sees in place of the images, where an augmentation says so.
    """

    images: Tensor
    K: Tensor
    aTc: Tensor
    kTc: Tensor
    uv: Tensor
    depth: Tensor
    mask: Tensor
    seen_uv: Tensor
    seen_depth: Tensor
    seen_mask: Tensor
    altered: Tensor | None = None

    @property
    def inputs(self) -> Tensor:
        """What the network sees, (B, 5, 3, H, W): the images, unless an augmentation altered them."""
        return self.images if self.altered is None else self.altered

    def at_size(self, height: int, width: int) -> RefinementBatch:
        """Return the batch with cameras and keypoints of images of another size; the images themselves stay.

        A network's depth maps need not have the size of its input.
        """
        before = self.images.shape[-2:]
        if (height, width) == tuple(before):
            return self
        factor = self.uv.new_tensor([width / before[1], height / before[0]])
        K = self.K.clone()
        K[..., :2, :2] = K[..., :2, :2] * factor[:, None]
        K[..., :2, 2] = resize_pixels(K[..., :2, 2], factor)
        return self._replace(K=K, uv=resize_pixels(self.uv, factor), seen_uv=resize_pixels(self.seen_uv, factor))
