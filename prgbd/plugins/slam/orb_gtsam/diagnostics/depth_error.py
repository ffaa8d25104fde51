"""How wrong measured depth is, judged by triangulation: the map's own points tell, without any true depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.core.multiview import rows_by_group, triangulate
from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.geometry.lie import inverse
from prgbd.plugins.slam.orb_gtsam.map.map import Map

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Keyframes that must see a point, so that its place does not rest on a single wrong match.
_LEAST_VIEWS = 3
# Largest relative standard deviation of a triangulated depth that is worth comparing with.
_ACCURATE = 0.1
# Distance that keeps the weight of a point in a camera's centre finite.
_NEAREST = 1e-9
# Fewer depths do not tell the scale of a keyframe, fewer keyframes not how the scale wanders.
_LEAST_DEPTHS = 20
_LEAST_KEYFRAMES = 5
# Standard deviation of a normal distribution per median absolute deviation.
_NORMAL = 1.4826
# Relative variance of the median of a normal sample per variance of its mean.
_OF_MEDIAN = np.pi / 2


@dataclass(frozen=True)
class DepthError:
    """Error of measured depth relative to the map: ``log(measured / triangulated) = bias + s_keyframe + e_point``.

    Attributes:
        sigma: Standard deviation of ``s + e``, which is the relative error of a depth once the map's scale is out.
        shared: Share of that variance that the depths of a keyframe have in common (``s``). A scale that drifts in the
            map counts as well: the two cannot be told apart.
        keyframes: Keyframes that were judged.
        depths: Depths that were judged.
    """

    sigma: float
    shared: float
    keyframes: int
    depths: int


def variance_components(error: FloatArray, noise: FloatArray, keyframe: IntArray) -> DepthError | None:
    """Split errors into what the depths of a keyframe have in common and what each has for itself.

    Medians and median absolute deviations take the place of means and variances, as matches and depths at borders may
    be far off. What the comparison itself is uncertain by is taken out of both parts.

    Args:
        error: (N,) logarithms of measured over triangulated depth.
        noise: (N,) standard deviation of the logarithm of the triangulated depth.
        keyframe: (N,) number of the keyframe of each depth.

    Returns:
        The components, None where fewer than five keyframes have at least 20 depths.
    """
    groups = rows_by_group(keyframe, _LEAST_DEPTHS)
    if len(groups) < _LEAST_KEYFRAMES:
        return None
    scales = np.array([np.median(error[rows]) for rows in groups])
    # Variance of a keyframe's depths about their median, less that of the triangulation.
    spread = np.array([_variance(error[rows]) for rows in groups])
    own = max(0.0, float(np.median(spread - [np.median(noise[rows] ** 2) for rows in groups])))
    # The median of a keyframe is uncertain by what its depths differ.
    count = np.array([len(rows) for rows in groups])
    common = max(0.0, _variance(scales) - float(np.median(_OF_MEDIAN * spread / count)))
    total = own + common
    share = common / total if total > 0 else 0.0
    return DepthError(float(np.sqrt(total)), share, len(groups), int(count.sum()))


def depth_error(slam_map: Map, camera: CameraModel) -> DepthError | None:
    """Compare the measured depths of all keyframes with points that are triangulated from their pixels alone.

    Returns:
        The error, None where too few points are seen with enough parallax.
    """
    kf, pts = slam_map.keyframes, slam_map.points
    alive = np.flatnonzero(~kf.bad[: kf.count])
    points = slam_map.seen_by(alive)
    seen = slam_map.observations(points)
    views = np.bincount(seen[:, 2], minlength=len(points))
    seen = seen[views[seen[:, 2]] >= _LEAST_VIEWS]
    at, row, point = seen.T
    if len(seen) == 0:
        return None
    wTc = inverse(kf.cTw[at])
    # A pixel's accuracy holds a point across its ray, at about the distance at which the map has it.
    distance = np.linalg.norm(pts.xyz[points[point]] - wTc[:, :3, 3], axis=1)
    sigma = np.maximum(distance, _NEAREST) * slam_map.scales[kf.octave[at, row]] / camera.pinhole.fx
    found = triangulate(wTc, camera.rays(kf.uv[at, row]), point, len(points), sigma)
    depth, spread = found.depth(wTc, point)
    measured = kf.depth[at, row].astype(np.float64)
    good = (measured > 0) & (depth > 0) & (spread < _ACCURATE * depth)
    ratio = np.log(measured[good] / depth[good])
    return variance_components(ratio, spread[good] / depth[good], at[good])


def _variance(values: FloatArray) -> float:
    """Robust variance: of the normal distribution with the same median absolute deviation."""
    return float(_NORMAL * np.median(np.abs(values - np.median(values)))) ** 2
