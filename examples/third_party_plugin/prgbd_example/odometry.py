"""``example/rgbd_vo``: RGB-D visual odometry. Each frame is located against the last keyframe by PnP.

There is no bundle adjustment and no loop closing, so it drifts; it is the least that a SLAM plug-in has to do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from prgbd import (
    Frame,
    GeometricSLAM,
    Keyframes,
    MapPoints,
    Observations,
    PinholeCamera,
    SlamResult,
    TrackingResult,
    TrackingState,
    Trajectory,
)
from prgbd.core.errors import ConfigError

RATIO = 0.8  # a match must be this much better than the second best (Lowe, IJCV 2004)
PATIENCE = 5  # lost frames until a new map begins


@dataclass
class Features:
    """Keypoints of a frame: pixels (N, 2), ORB descriptors (N, 32) uint8, depth (N,) metres with 0 for unknown."""

    uv: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    depth: NDArray[np.float32]


@dataclass
class Keyframe:
    """A frame that others are located against; ``point`` (N,) is the map point of each keypoint, -1 for none."""

    frame_index: int
    timestamp: float
    wTc: NDArray[np.float64]
    map_id: int
    features: Features
    point: NDArray[np.int64]


class RgbdOdometry(GeometricSLAM):
    """RGB-D visual odometry.

    Args:
        features: ORB keypoints per frame.
        max_reprojection_error: Pixels that a match may be off.
        min_inliers: A frame with fewer matches that agree is lost.
        keyframe_ratio: A frame becomes a keyframe below this part of the most matches since the last one.
        max_gap: A frame becomes a keyframe this many frames after the last one.

    Raises:
        ConfigError: If ``min_inliers`` is too small for PnP.
    """

    modes: ClassVar[frozenset[str]] = frozenset({"rgbd"})

    def __init__(
        self,
        features: int = 1000,
        max_reprojection_error: float = 3.0,
        min_inliers: int = 20,
        keyframe_ratio: float = 0.7,
        max_gap: int = 5,
    ) -> None:
        if min_inliers < 6:
            raise ConfigError(f"slam.min_inliers={min_inliers} is too few to locate a frame; use 6 or more.")
        self.orb = cv2.ORB_create(features)
        self.matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        self.max_reprojection_error = max_reprojection_error
        self.min_inliers = min_inliers
        self.keyframe_ratio = keyframe_ratio
        self.max_gap = max_gap

    def reset(
        self, camera: PinholeCamera, mode: str, *, baseline: float | None = None, fps: float = 30.0, seed: int = 0
    ) -> None:
        """See ``GeometricSLAM.reset``; the baseline and the frame rate are not used."""
        if mode not in self.modes:
            raise ConfigError(f"example/rgbd_vo has no mode '{mode}'; it needs depth: use slam.mode=rgbd.")
        cv2.setRNGSeed(seed)
        self.camera, self.mode = camera, mode
        self.keyframes: list[Keyframe] = []
        self.poses: list[tuple[int, float, NDArray[np.float64]]] = []
        self.xyz: list[NDArray[np.float64]] = []  # of the map points, a block per keyframe
        self.rgb: list[NDArray[np.uint8]] = []
        self.states: list[TrackingState] = []
        self.inliers: list[int] = []
        self.lost = self.most_matches = self.points = 0
        self.last = np.eye(4)

    def track(self, frame: Frame) -> TrackingResult:
        """See ``GeometricSLAM.track``."""
        result = self._locate(frame, self._detect(frame))
        if result.wTc is not None:
            self.last, self.lost = result.wTc, 0
            self.poses.append((frame.index, frame.timestamp, result.wTc))
        self.states.append(result.state)
        self.inliers.append(result.inliers)
        return result

    def finish(self) -> SlamResult:
        """See ``GeometricSLAM.finish``."""
        index, stamps, wTc = zip(*self.poses, strict=True) if self.poses else ((), (), ())
        keyframes = Keyframes(
            np.array([k.frame_index for k in self.keyframes], np.int64),
            np.array([k.timestamp for k in self.keyframes]),
            np.array([k.wTc for k in self.keyframes]).reshape(-1, 4, 4),
            np.array([k.map_id for k in self.keyframes], np.int32),
        )
        seen = [np.flatnonzero(k.point >= 0) for k in self.keyframes]
        pairs = list(zip(self.keyframes, seen, strict=True))
        observations = Observations(
            np.repeat(np.arange(len(seen)), [len(s) for s in seen]).astype(np.int64),
            np.concatenate([k.point[s] for k, s in pairs] or [np.zeros(0, np.int64)]),
            np.concatenate([k.features.uv[s] for k, s in pairs] or [np.zeros((0, 2), np.float32)]),
            np.concatenate([k.features.depth[s] for k, s in pairs] or [np.zeros(0, np.float32)]),
        )
        return SlamResult(
            self.camera,
            self.mode,
            len(self.states),
            Trajectory(np.array(index, np.int64), np.array(stamps, float), np.array(wTc).reshape(-1, 4, 4)),
            keyframes,
            MapPoints(
                np.concatenate([np.zeros((0, 3)), *self.xyz]), np.vstack([np.zeros((0, 3), np.uint8), *self.rgb])
            ),
            observations,
            [str(state) for state in self.states],
            np.array(self.inliers, np.int32),
        )

    def _detect(self, frame: Frame) -> Features:
        keypoints, descriptors = self.orb.detectAndCompute(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), None)
        if descriptors is None:
            return Features(np.zeros((0, 2), np.float32), np.zeros((0, 32), np.uint8), np.zeros(0, np.float32))
        uv = np.array([k.pt for k in keypoints], np.float32)
        column, row = np.rint(uv).astype(int).T
        assert frame.depth is not None  # the passive checks refuse such a frame before it comes here
        return Features(uv, descriptors, frame.depth[row, column])

    def _locate(self, frame: Frame, features: Features) -> TrackingResult:
        if not self.keyframes or self.lost > PATIENCE:
            return self._begin_map(frame, features)
        reference = self.keyframes[-1]
        of_reference, of_frame = self._match(reference.features, features)
        cTr, inliers = self._solve(reference.features, features.uv, of_reference, of_frame)
        if cTr is None or len(inliers) < self.min_inliers:
            self.lost += 1
            return TrackingResult(TrackingState.LOST, None, len(inliers))
        wTc = reference.wTc @ np.linalg.inv(cTr)
        self.most_matches = max(self.most_matches, len(inliers))
        few = len(inliers) < self.keyframe_ratio * self.most_matches
        is_keyframe = few or frame.index - reference.frame_index >= self.max_gap
        if is_keyframe:
            point = np.full(len(features.uv), -1, np.int64)
            point[of_frame[inliers]] = reference.point[of_reference[inliers]]
            self._add_keyframe(frame, wTc, reference.map_id, features, point)
        return TrackingResult(TrackingState.OK, wTc, len(inliers), is_keyframe)

    def _begin_map(self, frame: Frame, features: Features) -> TrackingResult:
        """Start where the camera was last seen."""
        if np.count_nonzero(features.depth > 0) < self.min_inliers:
            state = TrackingState.LOST if self.keyframes else TrackingState.NOT_INITIALIZED
            return TrackingResult(state)
        map_id = self.keyframes[-1].map_id + 1 if self.keyframes else 0
        self._add_keyframe(frame, self.last, map_id, features, np.full(len(features.uv), -1, np.int64))
        return TrackingResult(TrackingState.OK, self.last, 0, True)

    def _match(self, first: Features, second: Features) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows of both that belong together, each of the second used once; the first ones have depth."""
        if len(first.uv) == 0 or len(second.uv) < 2:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        pairs = self.matcher.knnMatch(first.descriptors, second.descriptors, k=2)
        table = np.array([(a.queryIdx, a.trainIdx, a.distance, b.distance) for a, b in pairs])
        table = table[(table[:, 2] < RATIO * table[:, 3]) & (first.depth > 0)]
        table = table[np.argsort(table[:, 2], kind="stable")]
        _, best = np.unique(table[:, 1], return_index=True)
        return table[best, 0].astype(np.int64), table[best, 1].astype(np.int64)

    def _solve(
        self, first: Features, uv: NDArray[np.float32], of_first: NDArray[np.int64], of_second: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64] | None, NDArray[np.int64]]:
        """Locate the second camera, (4, 4) ``secondTfirst``, and say which matches agree with it."""
        none = None, np.zeros(0, np.int64)
        if len(of_first) < self.min_inliers:
            return none
        xyz = self.camera.backproject(first.uv[of_first], first.depth[of_first])
        pixels, K = uv[of_second].astype(np.float64), self.camera.K
        found, rotation, translation, inliers = cv2.solvePnPRansac(
            xyz, pixels, K, None, iterationsCount=200, reprojectionError=self.max_reprojection_error, confidence=0.999
        )
        if not found or inliers is None:
            return none
        agree = inliers.ravel().astype(np.int64)
        rotation, translation = cv2.solvePnPRefineLM(xyz[agree], pixels[agree], K, None, rotation, translation)
        secondTfirst = np.eye(4)
        secondTfirst[:3, :3] = cv2.Rodrigues(rotation)[0]
        secondTfirst[:3, 3] = translation.ravel()
        return secondTfirst, agree

    def _add_keyframe(
        self, frame: Frame, wTc: NDArray[np.float64], map_id: int, features: Features, point: NDArray[np.int64]
    ) -> None:
        """Store a keyframe; its keypoints that have depth but no map point get new ones."""
        new = np.flatnonzero((point < 0) & (features.depth > 0))
        point[new] = self.points + np.arange(len(new))
        self.points += len(new)
        xyz = self.camera.backproject(features.uv[new], features.depth[new])
        self.xyz.append(xyz @ wTc[:3, :3].T + wTc[:3, 3])
        column, row = np.rint(features.uv[new]).astype(int).T
        self.rgb.append(frame.image[row, column])
        self.keyframes.append(Keyframe(frame.index, frame.timestamp, wTc, map_id, features, point))
        self.most_matches = 0
