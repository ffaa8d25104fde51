"""The first two keyframes of a monocular map, and the frames around them."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_LOW, match_by_projection
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.geometry.two_view import TwoView, initialise_two_view
from prgbd.plugins.slam.orb_gtsam.map.keyframe_creation import KeyframeCreator
from prgbd.plugins.slam.orb_gtsam.optimisation.bundle_problem import BundleProblem
from prgbd.plugins.slam.orb_gtsam.optimisation.solver import BundleSolver
from prgbd.plugins.slam.orb_gtsam.settings import Settings
from prgbd.plugins.slam.orb_gtsam.tracking.initializer import Initializer, Placed, Started
from prgbd.plugins.slam.orb_gtsam.tracking.local_map import match_local_map
from prgbd.plugins.slam.orb_gtsam.tracking.tracked_frame import TrackedFrame
from prgbd.plugins.slam.orb_gtsam.tracking.tracker import MIN_INLIERS_MAP, RATIO_MOTION

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# ORB-SLAM2 (Tracking::MonocularInitialization): keypoints of both frames, and matches between them.
LEAST_MATCHES = 100


class TwoViewInitializer(Initializer):
    """Starts from two frames without depth (Tracking::MonocularInitialization); the unit is the median depth.

    ORB-SLAM2 tries each frame against one first frame and drops that when too few matches are left. Here the present
    frame is tried against several earlier ones, the oldest first, as more parallax makes a better start.

    Args:
        settings: Thresholds.
        camera: The camera.
        creator: Gets the two keyframes.
        solver: Adjusts the two views.
        least_keypoints: Keypoints that both frames must have.
        seed: Seed of the robust estimation.
    """

    # Coarser levels place their keypoints too badly for a first reconstruction.
    _COARSEST = 3
    # Share of the image width within which a keypoint is looked for: 100 pixels at 640.
    _WINDOW = 100.0 / 640.0
    _LEAST_POINTS = 50
    _LEAST_PARALLAX_OF_PLANE = 2.5
    _REMEMBERED = 30
    _TRIED = 3

    def __init__(
        self,
        settings: Settings,
        camera: CameraModel,
        creator: KeyframeCreator,
        solver: BundleSolver,
        least_keypoints: int,
        seed: int,
    ) -> None:
        super().__init__(creator, min(least_keypoints, LEAST_MATCHES))
        self.settings, self.camera, self.solver, self.seed = settings, camera, solver, seed
        width, height = camera.pinhole.width, camera.pinhole.height
        self._least_matches = min(LEAST_MATCHES, max(50, settings.features.count_in(width, height) // 10))
        self._earlier: deque[TrackedFrame] = deque(maxlen=self._REMEMBERED)
        self._firsts: deque[TrackedFrame] = deque(maxlen=self._REMEMBERED)

    def begin_at(self, cTw: FloatArray) -> None:
        """See ``Initializer.begin_at``."""
        super().begin_at(cTw)
        self._earlier.clear()
        self._firsts.clear()

    def add(self, frame: TrackedFrame) -> Started | None:
        """See ``Initializer.add``."""
        started = None
        if len(frame.features) >= self.least_keypoints:
            started = self._start(frame)
            self._firsts.append(frame)
        self._earlier.append(frame)
        if started is not None:
            self._earlier.clear()
            self._firsts.clear()
        return started

    def _start(self, frame: TrackedFrame) -> Started | None:
        tried = 0
        for first in list(self._firsts):
            if tried == self._TRIED:
                break
            rows, partners = self._match(first, frame)
            if len(rows) < self._least_matches:
                # What has left the view does not come back soon.
                self._firsts.remove(first)
                continue
            tried += 1
            views = initialise_two_view(
                first.features.uv[rows].astype(np.float64),
                frame.features.uv[partners].astype(np.float64),
                self.camera.pinhole.K,
                self.seed,
            )
            if views is not None and self._trusts(views):
                started = self._build(first, frame, rows[views.good], partners[views.good], views)
                if started is not None:
                    return started
        return None

    def _trusts(self, views: TwoView) -> bool:
        """Whether a reconstruction is safe to build on."""
        # A plane seen from nearby leaves two motions that explain it about equally well.
        flat = views.model == "H" and views.parallax < np.radians(self._LEAST_PARALLAX_OF_PLANE)
        return not flat and int(np.count_nonzero(views.good)) >= self._LEAST_POINTS

    def _match(self, first: TrackedFrame, frame: TrackedFrame) -> tuple[IntArray, IntArray]:
        features = first.features
        rows = np.flatnonzero(features.octave <= self._COARSEST)
        octave = features.octave[rows].astype(np.int64)
        around = np.full((len(rows), 3), -1.0)
        around[:, :2] = features.uv[rows]
        found = match_by_projection(
            around,
            np.full(len(rows), self._WINDOW * self.camera.pinhole.width),
            (octave - 1, octave + 1),
            features.descriptor[rows],
            frame.features,
            self.camera.columns,
            limit=DISTANCE_LOW,
            ratio=RATIO_MOTION,
            angles=features.angle[rows],
        )
        good = found >= 0
        return rows[good], found[good]

    def _build(
        self, first: TrackedFrame, second: TrackedFrame, rows: IntArray, partners: IntArray, views: TwoView
    ) -> Started | None:
        xyz, c2Tc1, inlier = self._adjust(first, second, rows, partners, views)
        in_second = xyz @ c2Tc1[:3, :3].T + c2Tc1[:3, 3]
        good = inlier & (xyz[:, 2] > 0) & (in_second[:, 2] > 0)
        if np.count_nonzero(good) < self._LEAST_POINTS:
            return None
        depth = float(np.median(xyz[good, 2]))
        xyz, c2Tc1 = xyz[good] / depth, c2Tc1.copy()
        c2Tc1[:3, 3] /= depth
        slam_map, creator, wTc1 = self.creator.map, self.creator, inverse(self.origin)
        first.clear()
        k1 = creator.add(first.index, first.timestamp, self.origin, first.features, first.points)
        cTw = c2Tc1 @ self.origin
        k2 = creator.add(second.index, second.timestamp, cTw, second.features, second.points)
        ids = slam_map.add_points(k1, rows[good], xyz @ wTc1[:3, :3].T + wTc1[:3, 3])
        slam_map.observe(k2, partners[good], ids)
        slam_map.points.created[ids] = k2
        slam_map.refresh(ids)
        self.starts.append(
            {
                "frames": [first.index, second.index],
                "points": len(ids),
                "model": views.model,
                "parallax_degrees": round(float(np.degrees(views.parallax)), 2),
            }
        )
        earlier = [*self._place_earlier(first, k1, ids), _placed(first, k1, self.origin, len(ids))]
        earlier += self._place_between(first, second, k1, k2, ids)
        earlier.sort(key=lambda placed: placed.ordinal)
        return Started(k2, (k1, k2), cTw, slam_map.points_of(k2).copy(), earlier)

    def _adjust(
        self, first: TrackedFrame, second: TrackedFrame, rows: IntArray, partners: IntArray, views: TwoView
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Bundle adjustment of the two views, the first one fixed; return points, motion and which points are good."""
        n, variance = len(rows), self.camera.inverse_variance
        problem = BundleProblem(
            cTw=np.stack([np.eye(4), views.c2Tc1]),
            fixed=np.array([True, False]),
            xyz=views.xyz[views.good],
            pose_row=np.repeat(np.arange(2), n),
            point_row=np.tile(np.arange(n), 2),
            uvr=np.concatenate(
                [self.camera.measured(first.features, rows), self.camera.measured(second.features, partners)]
            ),
            inv_sigma2=np.concatenate(
                [variance[first.features.octave[rows]], variance[second.features.octave[partners]]]
            ),
            camera=self.camera.intrinsics,
        )
        result = self.solver.refine_locally(problem, iterations=(10, 10))
        return result.xyz, result.cTw[1], result.inlier[:n] & result.inlier[n:]

    def _place_earlier(self, first: TrackedFrame, k1: int, points: IntArray) -> list[Placed]:
        """Find the frames before the first keyframe, backwards from it, until one is not found."""
        placed: list[Placed] = []
        guess = self.origin
        for frame in reversed([f for f in self._earlier if f.ordinal < first.ordinal]):
            inliers = self._locate(frame, guess, points)
            if not inliers:
                break
            guess = frame.cTw
            placed.append(_placed(frame, k1, guess, inliers))
        return placed

    def _place_between(
        self, first: TrackedFrame, second: TrackedFrame, k1: int, k2: int, points: IntArray
    ) -> list[Placed]:
        """Find the frames between the two keyframes, each from the one before."""
        placed: list[Placed] = []
        guess = self.origin
        for frame in self._earlier:
            if not first.ordinal < frame.ordinal < second.ordinal:
                continue
            inliers = self._locate(frame, guess, points)
            if not inliers:
                continue
            guess = frame.cTw
            reference = k1 if 2 * frame.ordinal < first.ordinal + second.ordinal else k2
            placed.append(_placed(frame, reference, guess, inliers))
        return placed

    def _locate(self, frame: TrackedFrame, guess: FloatArray, points: IntArray) -> int:
        """Find the pose of an earlier frame near ``guess``; return its inliers, 0 if it is not found."""
        slam_map, gate = self.creator.map, self.settings.depth.gate
        inliers = 0
        frame.clear()
        frame.cTw = guess
        for factor in (8.0, 2.0):
            match_local_map(slam_map, frame, points, self.camera, factor=factor, gate=gate)
            inliers = frame.estimate_pose(slam_map, self.camera, frame.cTw)
            frame.drop_outliers()
        return inliers if inliers >= MIN_INLIERS_MAP else 0


def _placed(frame: TrackedFrame, reference: int, cTw: FloatArray, inliers: int) -> Placed:
    return Placed(frame.index, frame.ordinal, frame.timestamp, reference, cTw, inliers)
