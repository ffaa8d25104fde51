"""ORB features spread evenly over the image: FAST in cells, own selection and orientation, OpenCV's descriptors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import resize_pixels
from prgbd.plugins.slam.orb_gtsam.camera.depth_noise import spread_around
from prgbd.plugins.slam.orb_gtsam.features.feature_kernels import (
    cell_order,
    corners,
    fast_scores,
    orientations,
    select_evenly,
)
from prgbd.plugins.slam.orb_gtsam.settings import FeatureOptions

# Corners keep this far from the border of their level, so that patch and descriptor lie inside it.
EDGE = 19
GRID_CELL = 20.0
# ORB-SLAM2 (ORBextractor::ComputeKeyPointsOctTree): side of the FAST cells in pixels of the level.
CELL_SIZE = 30

Undistort = Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], NDArray[np.bool_]]]

# Pixels, angles, descriptors and levels of the keypoints of one pyramid level.
_Level = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint64], NDArray[np.int32]]
_NOTHING: _Level = (
    np.zeros((0, 2), np.float32),
    np.zeros(0, np.float32),
    np.zeros((0, 4), np.uint64),
    np.zeros(0, np.int32),
)


@dataclass
class Features:
    """The keypoints of one image as columns, sorted by grid cell.

    Attributes:
        uv: (N, 2) float32 pixels in the full-size image.
        octave: (N,) int32 pyramid level.
        angle: (N,) float32 degrees.
        descriptor: (N, 4) uint64, 256 bits.
        depth: (N,) float32 measured depth in metres, 0 where there is none.
        u_right: (N,) float32 column in the (virtual) right image, -1 where there is none.
        rgb: (N, 3) uint8 colour at the keypoint.
        cell_start: (cells + 1,) int32 first keypoint of every grid cell.
    """

    uv: NDArray[np.float32]
    octave: NDArray[np.int32]
    angle: NDArray[np.float32]
    descriptor: NDArray[np.uint64]
    depth: NDArray[np.float32]
    u_right: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    cell_start: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.uv)


class OrbExtractor:
    """Finds ORB features in images of one size.

    Args:
        options: Pyramid, thresholds and the number of features.
        width: Image width, pixels.
        height: Image height, pixels.
    """

    def __init__(self, options: FeatureOptions, width: int, height: int) -> None:
        self.options = options
        self.width, self.height = width, height
        self.columns = int(np.ceil(width / GRID_CELL))
        self.rows = int(np.ceil(height / GRID_CELL))
        self.scales = options.scales()
        self.capacity = options.count_in(width, height)
        shares = 1.0 / self.scales
        self._wanted = np.floor(self.capacity * shares / shares.sum()).astype(int)
        self._wanted[-1] = self.capacity - int(self._wanted[:-1].sum())
        self.sizes = [(round(width / s), round(height / s)) for s in self.scales]
        self._orb = cv2.ORB.create(
            nfeatures=self.capacity, nlevels=1, edgeThreshold=EDGE, patchSize=31, fastThreshold=options.fast_threshold
        )
        self._scores = [np.zeros((h, w), np.uint8) for w, h in self.sizes]
        # Every fourth pixel being a local maximum is more than an image can hold.
        self._xy = np.empty((width * height // 4 + 1, 2), np.int32)
        self._score = np.empty(len(self._xy), np.int32)
        # Grey levels of the last image, finest first.
        self.pyramid: list[NDArray[np.uint8]] = []

    def extract(
        self,
        image: NDArray[np.uint8],
        depth: NDArray[np.float32] | None,
        bf: float,
        trusted: float = np.inf,
        border: float = 0.0,
        *,
        undistort: Undistort | None = None,
    ) -> Features:
        """Find the features of an image.

        Args:
            image: (H, W, 3) uint8 RGB.
            depth: (H, W) float32 metres, 0 where unknown, or None.
            bf: Baseline times fx, metres times pixels, of the (virtual) stereo pair.
            trusted: Depths beyond give no right column.
            border: Nor do depths that differ by more than this share around the keypoint; 0 lets all of them.
            undistort: Moves keypoints to an ideal camera and says which lie within its image; depth and colour are
                read where the keypoint was found.

        Returns:
            At most ``capacity`` features.
        """
        gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        parts: list[_Level] = [_NOTHING]
        level: NDArray[np.uint8] = np.asarray(gray, np.uint8)
        self.pyramid = []
        for octave, size in enumerate(self.sizes):
            if min(size) <= 2 * EDGE + 2:
                break
            if octave:
                level = np.asarray(cv2.resize(level, size, interpolation=cv2.INTER_LINEAR), np.uint8)
            self.pyramid.append(level)
            parts.append(self._extract_level(level, octave))
        raw = np.concatenate([p[0] for p in parts])
        uv, inside = (raw, None) if undistort is None else undistort(raw)
        order, start = cell_order(uv, self.columns, self.rows, GRID_CELL)
        if inside is not None:
            order, start = _only(inside, order, start)
        uv = np.ascontiguousarray(uv[order])
        pixel = np.rint(raw[order]).astype(np.int64)
        u = np.clip(pixel[:, 0], 0, self.width - 1)
        v = np.clip(pixel[:, 1], 0, self.height - 1)
        measured = np.zeros(len(uv), np.float32) if depth is None else depth[v, u].astype(np.float32)
        measured[~np.isfinite(measured) | (measured <= 0)] = 0
        stereo = (measured > 0) & (measured <= trusted)
        if depth is not None and border > 0:
            stereo &= spread_around(depth)[v, u] <= border
        with np.errstate(divide="ignore", invalid="ignore"):
            u_right = np.where(stereo, uv[:, 0] - np.float32(bf) / measured, np.float32(-1)).astype(np.float32)
        return Features(
            uv,
            np.concatenate([p[3] for p in parts])[order],
            np.concatenate([p[1] for p in parts])[order],
            np.ascontiguousarray(np.concatenate([p[2] for p in parts])[order]),
            measured,
            u_right,
            np.ascontiguousarray(image[v, u]),
            start,
        )

    def _extract_level(self, level: NDArray[np.uint8], octave: int) -> _Level:
        height, width = level.shape
        scores = self._scores[octave]
        low, high = self.options.fast_threshold_low, self.options.fast_threshold
        fast_scores(level, low, EDGE, scores)
        count = corners(scores, high, CELL_SIZE, EDGE, self._xy, self._score)
        rows = select_evenly(self._xy, self._score, count, width, height, int(self._wanted[octave]))
        angle = orientations(level, self._xy, rows)
        xy = self._xy[rows].astype(np.float32)
        keypoints = [
            cv2.KeyPoint(x, y, 31.0, a, 0.0, 0, i)
            for i, ((x, y), a) in enumerate(zip(xy.tolist(), angle.tolist(), strict=True))
        ]
        kept, bits = self._orb.compute(level, keypoints) if keypoints else ((), None)
        if bits is None:
            bits = np.zeros((0, 32), np.uint8)
        if len(kept) != len(keypoints):
            index = np.array([k.class_id for k in kept], np.int64)
            xy, angle = xy[index], angle[index]
        uv = np.asarray(resize_pixels(xy, np.array([self.width / width, self.height / height])), np.float32)
        descriptor = np.ascontiguousarray(bits).view(np.uint64).reshape(-1, 4)
        return uv, angle, descriptor, np.full(len(uv), octave, np.int32)


def _only(
    inside: NDArray[np.bool_], order: NDArray[np.int64], start: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Leave keypoints out of an order by cells."""
    kept = inside[order]
    before = np.concatenate([[0], np.cumsum(kept)]).astype(np.int32)
    return order[kept], before[start]
