"""Observations brought to the same spot of the world: each keypoint of a point is aligned with an earlier one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.camera.camera_model import CameraModel
from prgbd.plugins.slam.orb_gtsam.camera.undistortion import Undistortion
from prgbd.plugins.slam.orb_gtsam.features.patch_alignment import AGREES, DISAGREES, UNDECIDED, align_patches
from prgbd.plugins.slam.orb_gtsam.features.recent_images import RecentImages
from prgbd.plugins.slam.orb_gtsam.kernels import kernel
from prgbd.plugins.slam.orb_gtsam.map.map import Map

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Normalised cross-correlation from which two patches show the same.
_LEAST_CORRELATION = 0.8
# Inverse variance over that of a keypoint of its level: of keypoints about which nothing could be said, of aligned and
# of refuted ones. On streets whose true poses are known aligned keypoints err by .2 to .3 pixels of their level. On
# four of them 8 and .05 gave the smallest error in the mean; 4 and .1, 4 and .01, and no observation for the refuted
# ones were as good within the scatter.
_PRECISION = np.zeros(3, np.float32)
_PRECISION[[UNDECIDED, AGREES, DISAGREES]] = 1.0, 8.0, 0.05
# A patch that is warped by more than this factor shows other detail.
_LARGEST_WARP = 1.8


class ObservationAligner:
    """Aligns what the last keyframes see of a point with what the earliest of them sees of it.

    A corner of FAST is found on whole pixels of a coarse level, and not twice on the same spot of the world, above all
    where the camera comes nearer and the level changes. Such errors do not average out: where the camera drives
    forward, matches lag behind the flow, and the map shrinks from keyframe to keyframe. Patches of grey levels have
    half the error, and keypoints whose patches disagree are hardly believed.

    Args:
        slam_map: The map.
        camera: The camera.
        images: Pyramids of the last keyframes.
        lens: Distortion of the images, if there is any.
    """

    def __init__(
        self, slam_map: Map, camera: CameraModel, images: RecentImages, lens: Undistortion | None = None
    ) -> None:
        self.map, self.camera, self.images, self.lens = slam_map, camera, images, lens

    def align(self, k: int) -> None:
        """Align the observations, in all keyframes whose images are kept, of the points that keyframe ``k`` sees.

        The caller holds ``Map.lock``.
        """
        kf, points = self.map.keyframes, self.map.points_of(k)
        slots = self.images.slots(kf.count)
        pairs = _pairs(
            kf.following,
            self.map.points.head,
            points[points >= 0],
            kf.aligned,
            kf.octave,
            self.map.scales,
            kf.cTw,
            self.map.points.xyz,
            slots,
            _LARGEST_WARP,
        )
        if len(pairs) == 0:
            return
        at, row, reference, its_row, point = pairs.T
        octave, its_octave = kf.octave[at, row].astype(np.int64), kf.octave[reference, its_row].astype(np.int64)
        images, xyz = self.images, self.map.points.xyz[point]
        warp = self._warps(at, reference, xyz, images.scale(octave)[:, 0], images.scale(its_octave)[:, 0])
        uv = self._distorted(kf.uv[at, row])
        xy = images.to_level(uv, octave)
        outcome = np.empty(len(xy), np.int8)
        align_patches(
            images.pixels,
            images.offset,
            images.width,
            images.height,
            slots[reference],
            its_octave,
            images.to_level(self._distorted(kf.uv[reference, its_row]), its_octave),
            slots[at],
            octave,
            warp,
            _LEAST_CORRELATION,
            xy,
            outcome,
        )
        kf.aligned[at, row] = point
        agrees = outcome == AGREES
        self._move(at[agrees], row[agrees], images.to_image(xy[agrees], octave[agrees]))
        kf.precision[at, row] = _PRECISION[outcome]
        # What others agree with is where the point is by definition, unless it was aligned itself.
        first = agrees & (kf.aligned[reference, its_row] != point)
        kf.aligned[reference[first], its_row[first]] = point[first]
        kf.precision[reference[first], its_row[first]] = _PRECISION[AGREES]

    def _warps(
        self, at: IntArray, reference: IntArray, xyz: FloatArray, scale: FloatArray, its_scale: FloatArray
    ) -> FloatArray:
        """Return how small offsets around a point turn and grow from the reference's level to the other one."""
        kf = self.map.keyframes
        depth = [np.einsum("nj,nj->n", kf.cTw[k, 2, :3], xyz) + kf.cTw[k, 2, 3] for k in (at, reference)]
        growth = its_scale * depth[1] / (scale * depth[0])
        R = np.einsum("nij,nkj->nik", kf.cTw[at, :2, :3], kf.cTw[reference, :2, :3])
        angle = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
        c, s = growth * np.cos(angle), growth * np.sin(angle)
        return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)

    def _distorted(self, uv: NDArray[np.float32]) -> FloatArray:
        return uv.astype(np.float64) if self.lens is None else self.lens.back(uv.astype(np.float64))

    def _move(self, at: IntArray, row: IntArray, raw: FloatArray) -> None:
        """Give keypoints new pixels; their right columns follow."""
        kf = self.map.keyframes
        uv = raw.astype(np.float32) if self.lens is None else self.lens(raw.astype(np.float32))[0]
        right = kf.u_right[at, row]
        kf.u_right[at, row] = np.where(right >= 0, right + uv[:, 0] - kf.uv[at, row, 0], right)
        kf.uv[at, row] = uv


@kernel()
def _pairs(
    following: np.ndarray,
    head: np.ndarray,
    points: np.ndarray,
    aligned: np.ndarray,
    octave: np.ndarray,
    scales: np.ndarray,
    cTw: np.ndarray,
    xyz: np.ndarray,
    slots: np.ndarray,
    largest: float,
) -> np.ndarray:
    """Find observations that were not aligned yet, and the earliest one of the same point that can be their reference.

    Returns:
        (M, 5) int64 rows ``(keyframe, keypoint, reference keyframe, its keypoint, point)``.
    """
    capacity = following.shape[1]
    flat_next, flat_aligned, flat_octave = following.reshape(-1), aligned.reshape(-1), octave.reshape(-1)
    out = np.empty((256, 5), np.int64)
    count = 0
    for p in points:
        at = head[p]
        while at >= 0:
            k = at // capacity
            if slots[k] >= 0 and flat_aligned[at] != p:
                z = cTw[k, 2, 0] * xyz[p, 0] + cTw[k, 2, 1] * xyz[p, 1] + cTw[k, 2, 2] * xyz[p, 2] + cTw[k, 2, 3]
                size = z * scales[flat_octave[at]]
                best = -1
                other = head[p]
                while other >= 0:
                    r = other // capacity
                    if r < k and slots[r] >= 0 and (best < 0 or r < best // capacity):
                        d = (
                            cTw[r, 2, 0] * xyz[p, 0]
                            + cTw[r, 2, 1] * xyz[p, 1]
                            + cTw[r, 2, 2] * xyz[p, 2]
                            + cTw[r, 2, 3]
                        )
                        its = d * scales[flat_octave[other]]
                        if z > 1e-6 and d > 1e-6 and its < largest * size and size < largest * its:
                            best = other
                    other = flat_next[other]
                if best >= 0:
                    if count == len(out):
                        larger = np.empty((2 * count, 5), np.int64)
                        larger[:count] = out
                        out = larger
                    out[count, 0], out[count, 1] = k, at % capacity
                    out[count, 2], out[count, 3] = best // capacity, best % capacity
                    out[count, 4] = p
                    count += 1
            at = flat_next[at]
    return out[:count].copy()
