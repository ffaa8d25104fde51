"""Compiled walks through the map's columns.

Each keypoint of a keyframe observes at most one point, so the observations of a point form a linked list through the
keypoints: ``head[point]`` is the first, ``following[keyframe, keypoint]`` the next one, each as
``keyframe * capacity + keypoint``; -1 ends the list.
"""

from __future__ import annotations

import numpy as np

from prgbd.plugins.slam.orb_gtsam.features.matching import hamming
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

_FAR = 1 << 20


@kernel()
def observe(
    point_of: np.ndarray, following: np.ndarray, head: np.ndarray, k: int, rows: np.ndarray, points: np.ndarray
) -> None:
    """Let keypoints ``rows`` of keyframe ``k`` observe ``points``; keypoints that already observe one are skipped."""
    capacity = point_of.shape[1]
    for i in range(len(rows)):
        if point_of[k, rows[i]] < 0:
            point_of[k, rows[i]] = points[i]
            following[k, rows[i]] = head[points[i]]
            head[points[i]] = k * capacity + rows[i]


@kernel()
def forget(point_of: np.ndarray, following: np.ndarray, head: np.ndarray, k: int, i: int) -> None:
    """Remove the observation of keypoint ``i`` of keyframe ``k``."""
    point = point_of[k, i]
    if point < 0:
        return
    here = k * point_of.shape[1] + i
    flat = following.reshape(-1)
    if head[point] == here:
        head[point] = flat[here]
    else:
        at = head[point]
        while at >= 0:
            if flat[at] == here:
                flat[at] = flat[here]
                break
            at = flat[at]
    flat[here] = -1
    point_of[k, i] = -1


@kernel()
def forget_many(
    point_of: np.ndarray, following: np.ndarray, head: np.ndarray, keyframes: np.ndarray, rows: np.ndarray
) -> None:
    """Remove several observations."""
    for j in range(len(keyframes)):
        forget(point_of, following, head, keyframes[j], rows[j])


@kernel()
def remove_points(
    point_of: np.ndarray, following: np.ndarray, head: np.ndarray, bad: np.ndarray, points: np.ndarray
) -> None:
    """Mark points as bad and free their keypoints."""
    flat_point, flat_next = point_of.reshape(-1), following.reshape(-1)
    for p in points:
        at = head[p]
        while at >= 0:
            after = flat_next[at]
            flat_point[at], flat_next[at] = -1, -1
            at = after
        head[p] = -1
        bad[p] = True


@kernel()
def merge_point(
    point_of: np.ndarray,
    following: np.ndarray,
    head: np.ndarray,
    bad: np.ndarray,
    replaced_by: np.ndarray,
    old: int,
    new: int,
) -> None:
    """Give the observations of ``old`` to ``new`` where a keyframe does not see ``new`` yet; ``old`` goes bad."""
    capacity = point_of.shape[1]
    flat_point, flat_next = point_of.reshape(-1), following.reshape(-1)
    at = head[old]
    while at >= 0:
        after = flat_next[at]
        seen, other = False, head[new]
        while other >= 0:
            seen |= other // capacity == at // capacity
            other = flat_next[other]
        if seen:
            flat_point[at], flat_next[at] = -1, -1
        else:
            flat_point[at], flat_next[at] = new, head[new]
            head[new] = at
        at = after
    head[old] = -1
    bad[old] = True
    replaced_by[old] = new


@kernel()
def count_observations(
    u_right: np.ndarray, following: np.ndarray, head: np.ndarray, points: np.ndarray, double: bool
) -> np.ndarray:
    """Return the number of observations of points; with ``double`` those with depth count twice, as in ORB-SLAM2."""
    flat_next, flat_right = following.reshape(-1), u_right.reshape(-1)
    counts = np.zeros(len(points), np.int64)
    for i in range(len(points)):
        at = head[points[i]] if points[i] >= 0 else -1
        while at >= 0:
            counts[i] += 2 if double and flat_right[at] >= 0 else 1
            at = flat_next[at]
    return counts


@kernel()
def common_points(
    point_ids: np.ndarray, following: np.ndarray, head: np.ndarray, keyframes: int, capacity: int
) -> np.ndarray:
    """Return how many of the points ``point_ids`` (-1 for none) every keyframe sees, (keyframes,) int64."""
    counts = np.zeros(keyframes, np.int64)
    flat_next = following.reshape(-1)
    for p in point_ids:
        at = head[p] if p >= 0 else -1
        while at >= 0:
            counts[at // capacity] += 1
            at = flat_next[at]
    return counts


@kernel()
def points_seen_by(point_of: np.ndarray, keyframes: np.ndarray, points: int) -> np.ndarray:
    """Return the different points that some keyframes see, in order of first sight, int64."""
    seen = np.zeros(points, np.bool_)
    found = np.empty(points, np.int64)
    n = 0
    for k in keyframes:
        for p in point_of[k]:
            if p >= 0 and not seen[p]:
                seen[p] = True
                found[n] = p
                n += 1
    return found[:n].copy()


@kernel()
def observations_of(following: np.ndarray, head: np.ndarray, points: np.ndarray, capacity: int) -> np.ndarray:
    """List the observations of points: (M, 3) int64 rows ``(keyframe, keypoint, position in points)``."""
    flat_next = following.reshape(-1)
    total = 0
    for p in points:
        at = head[p]
        while at >= 0:
            total += 1
            at = flat_next[at]
    out = np.empty((total, 3), np.int64)
    n = 0
    for i in range(len(points)):
        at = head[points[i]]
        while at >= 0:
            out[n, 0], out[n, 1], out[n, 2] = at // capacity, at % capacity, i
            n += 1
            at = flat_next[at]
    return out


@kernel()
def refresh_geometry(
    following: np.ndarray,
    head: np.ndarray,
    points: np.ndarray,
    capacity: int,
    centres: np.ndarray,
    octave: np.ndarray,
    scales: np.ndarray,
    reference: np.ndarray,
    xyz: np.ndarray,
    normal: np.ndarray,
    distance_range: np.ndarray,
) -> None:
    """Recompute viewing direction and range of distances of points (MapPoint::UpdateNormalAndDepth).

    The range spans the distances at which the point's pyramid level at its reference keyframe stays inside the pyramid.
    """
    flat_next, flat_octave = following.reshape(-1), octave.reshape(-1)
    top = len(scales) - 1
    for p in points:
        nx, ny, nz = 0.0, 0.0, 0.0
        at = head[p]
        if at < 0:
            continue
        anchor = at
        while at >= 0:
            k = at // capacity
            if k == reference[p]:
                anchor = at
            dx, dy, dz = xyz[p, 0] - centres[k, 0], xyz[p, 1] - centres[k, 1], xyz[p, 2] - centres[k, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-12
            nx, ny, nz = nx + dx / length, ny + dy / length, nz + dz / length
            at = flat_next[at]
        length = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
        normal[p, 0], normal[p, 1], normal[p, 2] = nx / length, ny / length, nz / length
        k = anchor // capacity
        reference[p] = k
        dx, dy, dz = xyz[p, 0] - centres[k, 0], xyz[p, 1] - centres[k, 1], xyz[p, 2] - centres[k, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        distance_range[p, 1] = length * scales[flat_octave[anchor]]
        distance_range[p, 0] = distance_range[p, 1] / scales[top]


@kernel()
def refresh_descriptors(
    following: np.ndarray, head: np.ndarray, points: np.ndarray, kf_descriptors: np.ndarray, descriptors: np.ndarray
) -> None:
    """Give points the observed descriptor with the least median distance to the others."""
    flat_next, flat_descriptors = following.reshape(-1), kf_descriptors.reshape(-1, 4)
    most = 32  # more observations make no better descriptor
    seen = np.empty(most, np.int64)
    distance = np.zeros((most, most), np.int64)
    for p in points:
        n, at = 0, head[p]
        while at >= 0 and n < most:
            seen[n] = at
            n += 1
            at = flat_next[at]
        if n == 0:
            continue
        for i in range(n):
            distance[i, i] = 0
            for j in range(i):
                d = hamming(flat_descriptors[seen[i]], flat_descriptors[seen[j]])
                distance[i, j], distance[j, i] = d, d
        best, chosen = _FAR, 0
        for i in range(n if n > 2 else 1):
            median = _median(distance[i], n)
            if median < best:
                best, chosen = median, i
        for i in range(4):
            descriptors[p, i] = flat_descriptors[seen[chosen], i]


@kernel()
def _median(values: np.ndarray, n: int) -> int:
    """Return the (lower) median of the first ``n`` values, without sorting them in place."""
    for i in range(n):
        below, equal = 0, 0
        for j in range(n):
            below += values[j] < values[i]
            equal += values[j] == values[i]
        if below <= (n - 1) // 2 < below + equal:
            return values[i]
    return values[0]
