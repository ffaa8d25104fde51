"""Geometric verification of a loop candidate: does the scene of one keyframe fit onto that of the other?"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.features.matching import DISTANCE_LOW, match_by_descriptor, match_by_projection
from prgbd.plugins.slam.orb_gtsam.geometry import sim3 as sim
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.optimisation.pose_optimisation import optimise_pose

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

# ORB-SLAM2 (ORBmatcher::SearchBySim3, SearchByProjection): search radii in pixels of the level.
_RADIUS_PAIRS, _RADIUS_POINTS = 7.5, 10.0
# ORB-SLAM2 (LoopClosing::ComputeSim3): ratio test between the two keyframes, inliers that their similarity needs, and
# points around the candidate that must be found in the new keyframe.
RATIO, MIN_INLIERS, MIN_MATCHES = 0.75, 20, 40
# Most neighbours of the candidate whose points are looked for.
_NEIGHBOURS = 20
# Inliers must fall into this many of the cells (columns, rows) of the image: a sign or a window alone is no place.
_CELLS, _LEAST_CELLS = (6, 4), 6
# Share of the points matched in the last search that must agree with one pose.
_LEAST_AGREEING = 0.6
# Difference of scale (log) that measured depth may show by chance.
_SAME_SCALE = 0.1
# Scales that a sensor's or a network's depth can drift to.
_DEPTH_SCALES = (0.5, 2.0)


@dataclass(frozen=True)
class Loop:
    """A verified loop: keyframe ``k`` shows what ``candidate`` shows.

    Attributes:
        k: The new keyframe.
        candidate: The keyframe of the same place.
        cTw: (4, 4) pose of ``k`` by the candidate's points, in the candidate's units.
        scale: Units of ``k`` per unit of the candidate.
        rows: (M,) int64 keypoints of ``k`` ...
        points: ... and the points around the candidate that they show.
        free_scale: Whether the scale was estimated.
    """

    k: int
    candidate: int
    cTw: FloatArray
    scale: float
    rows: IntArray
    points: IntArray
    free_scale: bool


class LoopVerifier:
    """Verifies candidates by a similarity and by the map around them.

    Args:
        slam_map: The map.
        camera: The camera.
        covisibility: Covisible keyframes.
        scale: Whether a loop corrects scale: "free", "fixed" or "auto".
        seed: Seed of RANSAC.
    """

    def __init__(
        self,
        slam_map: Map,
        camera: CameraModel,
        covisibility: CovisibilityGraph,
        scale: str,
        seed: int,
    ) -> None:
        self.map, self.camera, self.covisibility = slam_map, camera, covisibility
        self.scale, self.seed = scale, seed

    def verify(self, k: int, candidate: int) -> Loop | None:
        """Return the loop if the two keyframes see the same place, else None."""
        matches = self._match(k, candidate)
        if len(matches) < MIN_INLIERS:
            return None
        chosen = self.scale
        found = self._similarity(k, candidate, matches, free_scale=True)
        if found is None:
            return None
        if chosen == "free" or (chosen == "auto" and self.camera.without_unit):
            return self._against_map(k, candidate, found, free_scale=True)
        if abs(np.log(sim.scale_of(found))) > _SAME_SCALE:
            # What fits only in another size: a network's depth has drifted, or these are two places.
            return None if chosen == "fixed" else self._against_map(k, candidate, found, free_scale=True)
        found = self._similarity(k, candidate, matches, free_scale=False)
        return None if found is None else self._against_map(k, candidate, found, free_scale=False)

    def _match(self, k: int, candidate: int) -> IntArray:
        """Match the points of two keyframes by descriptor: (M, 2) keypoints of both."""
        ours, theirs = (np.flatnonzero(self.map.points_of(n) >= 0) for n in (k, candidate))
        if len(ours) == 0 or len(theirs) == 0:
            return np.zeros((0, 2), np.int64)
        features = self.map.features(k)
        found = match_by_descriptor(
            features.descriptor[ours],
            features.angle[ours],
            _subset(self.map.features(candidate), theirs),
            limit=DISTANCE_LOW,
            ratio=RATIO,
        )
        return np.stack([ours[found >= 0], theirs[found[found >= 0]]], axis=1)

    def _similarity(self, k: int, candidate: int, matches: IntArray, free_scale: bool) -> FloatArray | None:
        """Estimate ``kSc`` from matches, find more matches by it, refine it."""
        least = MIN_INLIERS
        rng = np.random.default_rng([self.seed, k, candidate])
        pairs = self._correspondences(k, candidate, matches)
        found = sim.ransac(pairs, rng, free_scale=free_scale, least=least)
        if found is None:
            return None
        kSc, inlier = sim.refine(pairs, *found, free_scale=free_scale)
        if not self._plausible(kSc):
            return None
        matches = self._more_matches(k, candidate, kSc, matches[inlier])
        pairs = self._correspondences(k, candidate, matches)
        kSc, inlier = sim.refine(pairs, kSc, np.ones(len(pairs), np.bool_), free_scale=free_scale)
        if inlier.sum() < least or not self._plausible(kSc):
            return None
        return kSc

    def _plausible(self, kSc: FloatArray) -> bool:
        scale = sim.scale_of(kSc)
        low, high = (0.0, np.inf) if self.camera.without_unit else _DEPTH_SCALES
        return bool(np.isfinite(kSc).all()) and low < scale < high

    def _correspondences(self, k: int, candidate: int, matches: IntArray) -> sim.Correspondences:
        kf, pts = self.map.keyframes, self.map.points
        columns: list[FloatArray] = []
        for n, rows in ((k, matches[:, 0]), (candidate, matches[:, 1])):
            cTw = kf.cTw[n]
            columns.append(pts.xyz[kf.point[n, rows]] @ cTw[:3, :3].T + cTw[:3, 3])
            columns.append(kf.uv[n, rows].astype(np.float64))
            columns.append(self.camera.inverse_variance[kf.octave[n, rows]])
        return sim.Correspondences(
            columns[0], columns[3], columns[1], columns[4], columns[2], columns[5], self.camera.intrinsics[:4]
        )

    def _more_matches(self, k: int, candidate: int, kSc: FloatArray, matches: IntArray) -> IntArray:
        """Project each keyframe's other points into the other one; keep the pairs that find each other."""
        kf = self.map.keyframes
        there = self._search(k, candidate, _rigid(sim.invert(kSc)) @ kf.cTw[k], matches[:, 0], matches[:, 1])
        here = self._search(candidate, k, _rigid(kSc) @ kf.cTw[candidate], matches[:, 1], matches[:, 0])
        rows = np.flatnonzero(there >= 0)
        mutual = rows[here[there[rows]] == rows]
        return np.concatenate([matches, np.stack([mutual, there[mutual]], axis=1)])

    def _search(self, source: int, target: int, cTw: FloatArray, mine: IntArray, taken: IntArray) -> IntArray:
        """Return for every keypoint of ``source`` that of ``target`` which shows its point, -1 for none.

        ``cTw`` is the pose of the target in the world and units of the source.
        """
        slam_map = self.map
        found = np.full(len(slam_map.points_of(source)), -1, np.int64)
        wanted = slam_map.points_of(source) >= 0
        wanted[mine] = False
        rows = np.flatnonzero(wanted)
        blocked = slam_map.points_of(target) < 0
        blocked[taken] = True
        rows, match = self._project(slam_map.points_of(source)[rows], rows, target, cTw, _RADIUS_PAIRS, blocked)
        found[rows] = match
        return found

    def _project(
        self,
        points: IntArray,
        rows: IntArray,
        target: int,
        cTw: FloatArray,
        radius: float,
        taken: NDArray[np.bool_] | None,
    ) -> tuple[IntArray, IntArray]:
        """Match points to the keypoints of ``target`` at pose ``cTw``; return the matched of ``rows``, and those."""
        slam_map, camera, pts = self.map, self.camera, self.map.points
        shown = camera.project(pts.xyz[points], pts.normal[points], pts.distance_range[points], cTw)
        inside = np.flatnonzero(shown.visible)
        level, uvr = shown.level[inside], shown.uvr[inside]
        uvr[:, 2] = -1.0
        found = match_by_projection(
            uvr,
            radius * camera.scales[level],
            (level - 1, level + 1),
            pts.descriptor[points[inside]],
            slam_map.features(target),
            camera.columns,
            limit=DISTANCE_LOW,
            taken=taken,
        )
        return rows[inside[found >= 0]], found[found >= 0]

    def _against_map(self, k: int, candidate: int, kSc: FloatArray, free_scale: bool) -> Loop | None:
        """Look for all points around the candidate, and judge by the pose that they give."""
        slam_map, camera = self.map, self.camera
        around = np.append(candidate, self.covisibility.of(candidate)[:_NEIGHBOURS])
        points = slam_map.seen_by(around)
        cTw = _rigid(kSc) @ slam_map.keyframes.cTw[candidate]
        points, rows = self._project(points, points, k, cTw, _RADIUS_POINTS, None)
        if len(rows) < MIN_MATCHES:
            return None
        features = slam_map.features(k)
        uvr = camera.measured(features, rows)
        if free_scale:
            # The measured depth of k is in its own units.
            uvr[:, 2] = -1.0
        weight = camera.weights(features.octave[rows], features.depth[rows])
        cTw, inlier = optimise_pose(
            cTw, slam_map.points.xyz[points], uvr, weight, camera.intrinsics, depth_fallback=camera.noise.fallback
        )
        enough = inlier.sum() >= max(MIN_MATCHES, _LEAST_AGREEING * len(rows))
        if not enough or not self._spread(features.uv[rows[inlier]]):
            return None
        return Loop(k, candidate, cTw, sim.scale_of(kSc), rows[inlier], points[inlier], free_scale)

    def _spread(self, uv: NDArray[np.float32]) -> bool:
        """Whether pixels lie all over the image."""
        camera = self.camera.pinhole
        column = np.clip(uv[:, 0] * _CELLS[0] / camera.width, 0, _CELLS[0] - 1).astype(np.int64)
        row = np.clip(uv[:, 1] * _CELLS[1] / camera.height, 0, _CELLS[1] - 1).astype(np.int64)
        return len(np.unique(row * _CELLS[0] + column)) >= _LEAST_CELLS


def _rigid(kSc: FloatArray) -> FloatArray:
    """Return the pose of k seen from c in the units of c: what ``kSc`` shows is the same at any size."""
    out = kSc.copy()
    out[:3] /= sim.scale_of(kSc)
    return out


def _subset(features: Features, rows: IntArray) -> Features:
    """Return some keypoints; their grid is gone."""
    kept = {
        field.name: getattr(features, field.name)[rows]
        for field in dataclasses.fields(features)
        if field.name != "cell_start"
    }
    return Features(**kept, cell_start=np.zeros(0, np.int32))


def relative_pose(loop: Loop, slam_map: Map) -> FloatArray:
    """Return ``cTk``, the pose of the keyframe seen from the candidate, in the candidate's units."""
    out: FloatArray = slam_map.keyframes.cTw[loop.candidate] @ inverse(loop.cTw)
    return out
