"""The map: keyframes, points, and who sees what."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map import map_kernels as kernels
from prgbd.plugins.slam.orb_gtsam.map.locking import FairLock, StepLock
from prgbd.plugins.slam.orb_gtsam.map.map_columns import KeyframeColumns, PointColumns

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

# The row of a culled point serves a new one after this many keyframes: by then no frame or queue refers to it.
_QUARANTINE = 20


@dataclass
class MapCounts:
    """What happened to a map since it was begun or loaded, for the statistics."""

    keyframes_added: int = 0
    keyframes_culled: int = 0
    points_created: int = 0
    points_culled: int = 0
    depths_rejected: int = 0


class Map:
    """Keyframes and points, and who sees what.

    Attributes:
        probation: New points that may yet be culled, by the keyframe that they came with.
        counts: What happened, for the statistics.
        lock: Held by whoever reads or changes the map beside another thread; solvers work on copies without it.
        steps: The same lock for the mapper's side, which works in short steps and can be stopped between them.

    Args:
        capacity: Most keypoints of a keyframe.
        cells: Grid cells of an image.
        scales: (levels,) scale of every pyramid level.
    """

    def __init__(self, capacity: int, cells: int, scales: FloatArray) -> None:
        self.capacity = capacity
        self.scales = scales
        self.keyframes = KeyframeColumns(capacity, cells)
        self.points = PointColumns()
        self.current_map = 0
        self.probation: deque[tuple[int, IntArray]] = deque()
        self.counts = MapCounts()
        # Culled points, and how many keyframes there were then.
        self._gone: deque[tuple[int, IntArray]] = deque()
        self.lock = FairLock()
        self.steps = StepLock(self.lock)

    # Keyframes -------------------------------------------------------------------------------------------------

    def add_keyframe(
        self, frame_index: int, timestamp: float, cTw: FloatArray, features: Features, points: IntArray
    ) -> int:
        """Add a keyframe that observes ``points`` ((N,) int64, -1 for none) and return its number."""
        kf = self.keyframes
        k = kf.grow(1)
        n = len(features)
        kf.frame_index[k], kf.timestamp[k], kf.map_id[k], kf.size[k] = frame_index, timestamp, self.current_map, n
        kf.uv[k, :n], kf.octave[k, :n], kf.angle[k, :n] = features.uv, features.octave, features.angle
        kf.descriptor[k, :n], kf.depth[k, :n], kf.u_right[k, :n] = (
            features.descriptor,
            features.depth,
            features.u_right,
        )
        kf.rgb[k, :n], kf.cell_start[k] = features.rgb, features.cell_start
        self.set_pose(k, cTw)
        rows = np.flatnonzero(points >= 0)
        self.observe(k, rows, points[rows])
        self.counts.keyframes_added += 1
        return k

    def set_pose(self, k: int, cTw: FloatArray) -> None:
        """Move keyframe ``k``."""
        self.keyframes.cTw[k] = cTw
        self.keyframes.centre[k] = -cTw[:3, :3].T @ cTw[:3, 3]

    def features(self, k: int) -> Features:
        """Return the keypoints of keyframe ``k`` as views."""
        kf, n = self.keyframes, int(self.keyframes.size[k])
        return Features(
            kf.uv[k, :n],
            kf.octave[k, :n],
            kf.angle[k, :n],
            kf.descriptor[k, :n],
            kf.depth[k, :n],
            kf.u_right[k, :n],
            kf.rgb[k, :n],
            kf.cell_start[k],
        )

    def points_of(self, k: int) -> IntArray:
        """Return the point of every keypoint of keyframe ``k``, (N,) int64 with -1 for none, as a view."""
        return self.keyframes.point[k, : self.keyframes.size[k]]

    def alive(self, map_id: int | None = None) -> IntArray:
        """Return the keyframes of a map (the current one by default) that are not culled."""
        kf = self.keyframes
        chosen = self.current_map if map_id is None else map_id
        return np.flatnonzero(~kf.bad[: kf.count] & (kf.map_id[: kf.count] == chosen))

    def map_ids(self) -> list[int]:
        """Return the numbers of the maps that have keyframes."""
        kf = self.keyframes
        return [int(n) for n in np.unique(kf.map_id[: kf.count][~kf.bad[: kf.count]])]

    def next_map(self) -> int:
        """Return the number of a new map."""
        return int(self.keyframes.map_id[: self.keyframes.count].max(initial=-1)) + 1

    def join(self, a: int, b: int) -> None:
        """Make one map of two; it has the later one's number, and is current if one of them was."""
        ids = self.keyframes.map_id[: self.keyframes.count]
        ids[ids == min(a, b)] = max(a, b)
        if self.current_map == min(a, b):
            self.current_map = max(a, b)

    def cull_keyframe(self, k: int, parent: int) -> None:
        """Take a keyframe out of the map; frames that refer to it follow ``parent`` from now on."""
        kf = self.keyframes
        rows = np.flatnonzero(kf.point[k] >= 0)
        self.forget(np.full(len(rows), k), rows)
        kf.bad[k], kf.parent[k] = True, parent
        kf.cTparent[k] = kf.cTw[k] @ inverse(kf.cTw[parent])
        kf.size[k] = 0
        kf.release(k)
        self.counts.keyframes_culled += 1

    def pose_of(self, k: int) -> FloatArray:
        """Return ``cTw`` of a keyframe, through the keyframes that took its place if it was culled."""
        kf = self.keyframes
        cTk = np.eye(4)
        while kf.bad[k]:
            cTk = cTk @ kf.cTparent[k]
            k = int(kf.parent[k])
        return cTk @ kf.cTw[k]

    def successor(self, k: int) -> int:
        """Return ``k``, or the keyframe that took its place."""
        while self.keyframes.bad[k]:
            k = int(self.keyframes.parent[k])
        return k

    # Points ----------------------------------------------------------------------------------------------------

    def add_points(self, k: int, rows: IntArray, xyz: FloatArray) -> IntArray:
        """Create points at ``xyz`` that keypoints ``rows`` of keyframe ``k`` observe; return their numbers."""
        pts = self.points
        ids = self._point_rows(len(rows))
        pts.xyz[ids] = xyz
        pts.rgb[ids] = self.keyframes.rgb[k, rows]
        pts.reference[ids] = pts.created[ids] = k
        self.observe(k, rows, ids)
        return ids

    def _point_rows(self, count: int) -> IntArray:
        """Return rows for new points, those of points first that were culled long enough ago."""
        rows = [np.zeros(0, np.int64)]
        missing = count
        while missing and self._gone and self._gone[0][0] + _QUARANTINE <= self.keyframes.count:
            since, gone = self._gone.popleft()
            if len(gone) > missing:
                self._gone.appendleft((since, gone[missing:]))
            rows.append(gone[:missing])
            missing -= len(rows[-1])
        self.points.clear(np.concatenate(rows))
        first = self.points.grow(missing)
        rows.append(np.arange(first, first + missing))
        self.counts.points_created += count
        return np.concatenate(rows)

    def observe(self, k: int, rows: IntArray, points: IntArray) -> None:
        """Let keypoints of keyframe ``k`` observe points."""
        kf = self.keyframes
        kernels.observe(kf.point, kf.following, self.points.head, k, rows, points)

    def forget(self, keyframes: IntArray, rows: IntArray) -> None:
        """Remove observations; the points stay."""
        kf = self.keyframes
        kernels.forget_many(kf.point, kf.following, self.points.head, keyframes, rows)

    def remove_points(self, points: IntArray) -> None:
        """Remove points and their observations."""
        kf, points = self.keyframes, points[~self.points.bad[points]]
        kernels.remove_points(kf.point, kf.following, self.points.head, self.points.bad, points)
        if len(points):
            self._gone.append((kf.count, points))

    def merge(self, old: int, new: int) -> None:
        """Let ``new`` take the place of ``old``."""
        kf, pts = self.keyframes, self.points
        pts.found[new] += pts.found[old]
        pts.visible[new] += pts.visible[old]
        kernels.merge_point(kf.point, kf.following, pts.head, pts.bad, pts.replaced_by, old, new)
        self._gone.append((kf.count, np.array([old])))

    def current(self, points: IntArray) -> IntArray:
        """Follow merged points to what replaced them; -1 for culled ones. (N,) int64 with -1 for none."""
        out = points.copy()
        pts = self.points
        for _ in range(16):
            gone = (out >= 0) & pts.bad[out]
            if not gone.any():
                break
            out[gone] = pts.replaced_by[out[gone]]
        out[(out >= 0) & pts.bad[out]] = -1
        return out

    def observation_counts(self, points: IntArray, *, double: bool) -> IntArray:
        """Return how many keypoints observe each point (-1: 0); with ``double`` those with depth count twice."""
        kf = self.keyframes
        return kernels.count_observations(kf.u_right, kf.following, self.points.head, points, double)

    def observations(self, points: IntArray) -> IntArray:
        """List the observations of points, (M, 3) int64 ``(keyframe, keypoint, position in points)``."""
        return kernels.observations_of(self.keyframes.following, self.points.head, points, self.capacity)

    def seen_by(self, keyframes: IntArray) -> IntArray:
        """Return the points that any of some keyframes sees."""
        keyframes = keyframes[~self.keyframes.bad[keyframes]]
        return kernels.points_seen_by(self.keyframes.point, np.ascontiguousarray(keyframes), self.points.count)

    def refresh(self, points: IntArray, *, descriptors: bool = True) -> None:
        """Recompute direction and distance range of points, and the descriptor, which only observations change."""
        kf, pts = self.keyframes, self.points
        kernels.refresh_geometry(
            kf.following,
            pts.head,
            points,
            self.capacity,
            kf.centre,
            kf.octave,
            self.scales,
            pts.reference,
            pts.xyz,
            pts.normal,
            pts.distance_range,
        )
        if descriptors:
            kernels.refresh_descriptors(kf.following, pts.head, points, kf.descriptor, pts.descriptor)
