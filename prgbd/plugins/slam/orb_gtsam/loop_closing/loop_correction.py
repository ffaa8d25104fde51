"""What a loop does to the map: poses by the essential graph, points with them, and duplicates merged."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse, log_se3
from prgbd.plugins.slam.orb_gtsam.loop_closing.loop_verification import Loop, relative_pose
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map
from prgbd.plugins.slam.orb_gtsam.map.map_correction import Correction
from prgbd.plugins.slam.orb_gtsam.map.merging import merge_duplicates
from prgbd.plugins.slam.orb_gtsam.optimisation.pose_graph import PoseGraphEdges, optimise_pose_graph

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

# Standard deviations of an edge between neighbours: radians, share of its length, log of scale. They tell how the
# correction is shared between turning, moving and scaling; drift grows with the square root of the edges.
_EDGE_SIGMAS = (0.01, 0.05, 0.03)
# The same of a loop edge, which many points measured at once.
_LOOP_SIGMAS = (0.002, 0.02, 0.005)
# A loop edge that the solution misses by this many standard deviations was refused by the robust weighting.
_REFUSED = 6.0
# ORB-SLAM2 (Optimizer::OptimizeEssentialGraph): common points that make an edge of the essential graph.
ESSENTIAL_WEIGHT = 100
# Neighbours on either side of a loop whose points are merged.
_MERGED = 20


def essential_edges(covisibility: CovisibilityGraph, keyframes: IntArray, weight: int) -> tuple[IntArray, IntArray]:
    """Return the edges of the essential graph: spanning tree and strong covisibility, later to earlier keyframe.

    Each keyframe hangs on the earlier one with which it shares most points, or else on the one before it.
    """
    later: list[int] = []
    earlier: list[int] = []
    for position, k in enumerate(keyframes.tolist()):
        if position == 0:
            continue
        before = keyframes[:position]
        shared = covisibility.common(covisibility.map.points_of(k))[before]
        parent = int(before[len(before) - 1 - int(np.argmax(shared[::-1]))])
        joined = dict.fromkeys([parent, *before[shared >= weight].tolist()])
        later.extend([k] * len(joined))
        earlier.extend(joined)
    return np.array(later, np.int64), np.array(earlier, np.int64)


def solve_loop(
    covisibility: CovisibilityGraph, loop: Loop, earlier_loops: list[tuple[int, int]], weight: int = ESSENTIAL_WEIGHT
) -> Correction | None:
    """Spread the error that a loop shows over its map by the essential graph; the map stays as it is.

    Loop edges are weighed robustly: what the rest of the graph contradicts beyond its uncertainty is refused.

    Args:
        covisibility: Covisible keyframes; the map's lock is held only while the graph is collected.
        loop: The loop, within one map.
        earlier_loops: Pairs of keyframes that earlier loops joined.
        weight: Common points of a strong edge.

    Returns:
        The new poses, or None if the loop was refused.
    """
    with covisibility.map.lock:
        keyframes, wTc, i, j, iTj, is_loop = _graph(covisibility, loop, earlier_loops, weight)
    ratio = np.ones(len(i))
    ratio[-1] = 1.0 / loop.scale
    sigmas = _sigmas(np.linalg.norm(iTj[:, :3, 3], axis=1), is_loop)
    free = loop.free_scale
    edges = PoseGraphEdges(i, j, iTj, sigmas if free else sigmas[:, :6], ratio if free else None, robust=is_loop)
    poses, scale = optimise_pose_graph(wTc, edges)
    reached = inverse(poses[i[-1]]) @ poses[j[-1]]
    reached[:3, 3] /= scale[i[-1]]
    error = np.append(log_se3(inverse(iTj[-1]) @ reached), np.log(scale[j[-1]] / scale[i[-1]] / ratio[-1]))
    if not loop.free_scale:
        error[6] = 0.0
    return Correction(keyframes, poses, scale) if np.linalg.norm(error / sigmas[-1]) < _REFUSED else None


def _graph(
    covisibility: CovisibilityGraph, loop: Loop, earlier_loops: list[tuple[int, int]], weight: int
) -> tuple[IntArray, FloatArray, IntArray, IntArray, FloatArray, NDArray[np.bool_]]:
    """Return keyframes, their poses, and the edges: rows of both ends, pose of j seen from i, which are loops.

    The new loop is the last edge.
    """
    slam_map, kf = covisibility.map, covisibility.map.keyframes
    keyframes = slam_map.alive(int(kf.map_id[loop.k]))
    column = np.full(kf.count, -1, np.int64)
    column[keyframes] = np.arange(len(keyframes))
    j, i = essential_edges(covisibility, keyframes, weight)
    kept = np.array([[slam_map.successor(n) for n in pair] for pair in earlier_loops], np.int64).reshape(-1, 2)
    kept = kept[(kept[:, 0] != kept[:, 1]) & (column[kept] >= 0).all(axis=1)]
    i, j = np.concatenate([i, kept[:, 1], [loop.candidate]]), np.concatenate([j, kept[:, 0], [loop.k]])
    is_loop = np.arange(len(i)) >= len(i) - 1 - len(kept)
    wTc = inverse(kf.cTw[keyframes])
    i, j = column[i], column[j]
    iTj = inverse(wTc[i]) @ wTc[j]
    iTj[-1] = relative_pose(loop, slam_map)
    return keyframes, wTc, i, j, iTj, is_loop


def _sigmas(length: FloatArray, is_loop: NDArray[np.bool_]) -> FloatArray:
    """Return the standard deviations (E, 7) of edges of these lengths."""
    typical = float(np.median(length[~is_loop])) + 1e-9
    out = np.empty((len(length), 7))
    for chosen, (turn, share, scale) in ((~is_loop, _EDGE_SIGMAS), (is_loop, _LOOP_SIGMAS)):
        out[chosen, :3], out[chosen, 6] = turn, scale
        out[chosen, 3:6] = share * np.maximum(length[chosen], typical)[:, None]
    return out


def move_map(slam_map: Map, loop: Loop) -> Correction:
    """Return the poses that bring the map of ``loop.k`` as a whole to where the loop's candidate is."""
    kf = slam_map.keyframes
    keyframes = slam_map.alive(int(kf.map_id[loop.k]))
    relative = kf.cTw[loop.k] @ inverse(kf.cTw[keyframes])
    relative[:, :3, 3] /= loop.scale
    return Correction(keyframes, inverse(loop.cTw) @ relative, np.full(len(keyframes), 1.0 / loop.scale))


def merge_both_sides(camera: CameraModel, covisibility: CovisibilityGraph, loop: Loop) -> None:
    """Let both sides of a loop, now in one place, see the same points; the caller holds ``Map.lock``."""
    slam_map, pts = covisibility.map, covisibility.map.points
    own = slam_map.points_of(loop.k)
    for row, point in zip(loop.rows.tolist(), slam_map.current(loop.points).tolist(), strict=True):
        if point < 0 or pts.bad[point] or own[row] == point:
            continue
        if own[row] >= 0:
            slam_map.merge(int(own[row]), point)
        else:
            slam_map.observe(loop.k, np.array([row]), np.array([point]))
    ours = np.append(loop.k, covisibility.of(loop.k)[:_MERGED])
    theirs = np.append(loop.candidate, covisibility.of(loop.candidate)[:_MERGED])
    ours, theirs = np.setdiff1d(ours, theirs), np.setdiff1d(theirs, ours)
    for targets, sources in ((ours, theirs), (theirs, ours)):
        for target in targets.tolist():
            merge_duplicates(slam_map, camera, target, slam_map.seen_by(sources))
    points = slam_map.seen_by(np.concatenate([ours, theirs]))
    slam_map.refresh(points)
    covisibility.clear()
