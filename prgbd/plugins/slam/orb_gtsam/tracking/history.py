"""What became of every frame, and the result made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.slam import TrackingState
from prgbd.core.types import Keyframes, MapPoints, Observations, SlamResult, Trajectory
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.map import Map

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class _Row:
    """A frame, its pose relative to a keyframe in the units that the map had then, and its pose as known then."""

    frame_index: int
    timestamp: float
    reference: int
    cTref: FloatArray
    scale: float
    wTc: FloatArray


class History:
    """Remembers each frame relative to its reference keyframe, so that it moves with it."""

    def __init__(self) -> None:
        self.states: list[str] = []
        self.inliers: list[int] = []
        self._rows: list[_Row] = []

    def add(self, state: TrackingState, inliers: int) -> None:
        """Count a frame."""
        self.states.append(state.value)
        self.inliers.append(inliers)

    def amend(self, ordinal: int, state: TrackingState, inliers: int) -> None:
        """Say anew what became of frame number ``ordinal``."""
        self.states[ordinal], self.inliers[ordinal] = state.value, inliers

    def place(
        self,
        frame_index: int,
        timestamp: float,
        reference: int,
        cTref: FloatArray,
        wTc: FloatArray,
        scale: float = 1.0,
    ) -> None:
        """Store the pose of a frame relative to keyframe ``reference`` of that ``scale``, and as it is known now."""
        self._rows.append(_Row(frame_index, timestamp, reference, cTref, scale, wTc))

    def trajectory(self, slam_map: Map) -> Trajectory:
        """Return the poses of all placed frames, corrected with their keyframes."""
        if not self._rows:
            return Trajectory.empty()
        poses = []
        for row in self._rows:
            cTref = row.cTref.copy()
            cTref[:3, 3] *= slam_map.keyframes.scale[row.reference] / row.scale
            poses.append(cTref @ slam_map.pose_of(row.reference))
        return self._trajectory(inverse(np.stack(poses)))

    def online(self) -> Trajectory:
        """Return the poses as they were known when the frames came."""
        return self._trajectory(np.stack([row.wTc for row in self._rows])) if self._rows else Trajectory.empty()

    def _trajectory(self, wTc: FloatArray) -> Trajectory:
        return Trajectory(
            np.array([row.frame_index for row in self._rows], np.int64),
            np.array([row.timestamp for row in self._rows]),
            wTc,
        )

    def result(self, slam_map: Map, camera: CameraModel, stats: dict[str, Any]) -> SlamResult:
        """Return everything in the contract's columns; keyframes of a loaded map, numbered below 0, are left out."""
        kf, pts = slam_map.keyframes, slam_map.points
        alive = np.flatnonzero(~kf.bad[: kf.count] & (kf.frame_index[: kf.count] >= 0))
        maps = np.unique(kf.map_id[alive], return_inverse=True)[1].astype(np.int32)
        row_of = np.full(kf.count, -1, np.int64)
        row_of[alive] = np.arange(len(alive))
        points = np.flatnonzero(~pts.bad[: pts.count] & (pts.head[: pts.count] >= 0))
        seen = slam_map.observations(points)
        seen = seen[row_of[seen[:, 0]] >= 0]
        order = np.lexsort((seen[:, 1], seen[:, 0]))
        at, keypoint, point = seen[order].T
        return SlamResult(
            camera=camera.pinhole,
            mode=camera.mode,
            frames=len(self.states),
            trajectory=self.trajectory(slam_map),
            keyframes=Keyframes(
                kf.frame_index[alive], kf.timestamp[alive], inverse(kf.cTw[alive]), maps.astype(np.int32)
            ),
            points=MapPoints(pts.xyz[points], pts.rgb[points]),
            observations=Observations(
                row_of[at], np.ascontiguousarray(point), kf.uv[at, keypoint], kf.depth[at, keypoint]
            ),
            states=list(self.states),
            inliers=np.array(self.inliers, np.int32),
            online=self.online(),
            stats=stats,
        )
