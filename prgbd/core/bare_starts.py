"""Maps that never grew beyond the frame that started them, which is no tracking."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from prgbd.core.slam import TrackingState
from prgbd.core.types import Keyframes, MapPoints, Observations, SlamResult, Trajectory


def without_bare_starts(result: SlamResult) -> SlamResult:
    """Count frames as lost that started a map in which nothing was ever found again.

    With depth a map starts from a single frame, whatever it shows. Where no later frame finds its place in that map,
    the frame's own pose rests on nothing: white noise, depth of a wrong unit, or frames out of order give a new map
    per frame.

    Args:
        result: What a system found out; of its ``keyframes`` ``map_id`` tells maps apart.

    Returns:
        The result without such maps, with their frames ``lost``; the same one if there are none.
    """
    rows = bare_starts(result)
    if not len(rows):
        return result
    keyframes, seen = result.keyframes, result.observations
    dropped = np.zeros(len(keyframes), bool)
    dropped[rows] = True
    frames = keyframes.frame_index[rows]
    of_dropped, of_kept = (np.unique(seen.point[dropped[seen.keyframe] == side]) for side in (True, False))
    kept_points = np.ones(len(result.points), bool)
    kept_points[np.setdiff1d(of_dropped, of_kept)] = False
    kept = ~dropped[seen.keyframe]
    states, inliers = list(result.states), result.inliers.copy()
    for frame in _numbers_in(result, frames):
        states[frame], inliers[frame] = TrackingState.LOST.value, 0
    return replace(
        result,
        trajectory=_without(result.trajectory, frames),
        online=None if result.online is None else _without(result.online, frames),
        keyframes=Keyframes(
            keyframes.frame_index[~dropped],
            keyframes.timestamp[~dropped],
            keyframes.wTc[~dropped],
            _renumbered(keyframes.map_id[~dropped]),
        ),
        points=MapPoints(result.points.xyz[kept_points], result.points.rgb[kept_points]),
        observations=Observations(
            (np.cumsum(~dropped) - 1)[seen.keyframe[kept]],
            (np.cumsum(kept_points) - 1)[seen.point[kept]],
            seen.uv[kept],
            seen.depth[kept],
        ),
        states=states,
        inliers=inliers,
    )


def bare_starts(result: SlamResult) -> NDArray[np.int64]:
    """Return the rows of the keyframes that are alone in their map, and that no frame with a pose follows.

    A frame belongs to the map of the last keyframe before it: where a camera stands still, one keyframe is enough for
    all that follow.
    """
    keyframes, placed = result.keyframes, result.trajectory.frame_index
    _, which, count = np.unique(keyframes.map_id, return_inverse=True, return_counts=True)
    # The next frame with a pose; where it is itself a keyframe, this map has found nothing.
    behind = np.searchsorted(placed, keyframes.frame_index, side="right")
    following = np.append(placed, -1)[np.minimum(behind, len(placed))]
    unfollowed = (following < 0) | np.isin(following, keyframes.frame_index)
    return np.flatnonzero((count[which] == 1) & unfollowed)


def _numbers_in(result: SlamResult, frames: NDArray[np.int64]) -> list[int]:
    """The positions of frames among all that were given: numbers count from any start where a part was run."""
    numbers = [int(frame) for frame in frames]
    return [number for number in numbers if 0 <= number < len(result.states)]


def _without(trajectory: Trajectory, frames: NDArray[np.int64]) -> Trajectory:
    kept = ~np.isin(trajectory.frame_index, frames)
    return Trajectory(trajectory.frame_index[kept], trajectory.timestamp[kept], trajectory.wTc[kept])


def _renumbered(map_id: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.unique(map_id, return_inverse=True)[1].astype(np.int32)
