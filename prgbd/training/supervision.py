"""From what SLAM found out to training samples: outlier removal and keyframe triplets (Tiwari et al., ECCV 2020)."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from prgbd.core.multiview import extreme_parallax, points_in_camera, reprojection_errors, rows_by_group
from prgbd.core.types import Observations, PinholeCamera, SlamResult

Floats = NDArray[np.float64]

# Adjacent frames should see the scene from places this far apart, as a share of its depth: below, parallax drowns in
# the noise of poses and image. A car at 10 Hz is above it from one frame to the next, a hand at 30 Hz in four.
_ADJACENT_PARALLAX = 0.015
_WIDEST_GAP = 15

NO_KEYFRAME_BEFORE = "no earlier keyframe in the same map"
NO_KEYFRAME_AFTER = "no later keyframe in the same map"
NO_ADJACENT_FRAME = "a temporally adjacent frame is lost, missing or in another map"


@dataclass(frozen=True)
class KeyframeSample:
    """One current keyframe c with its neighbours and the points that all three keyframes see.

    Attributes:
        current: Position of c in the sequence.
        map_id: Map that c belongs to; maps that are not connected may differ in scale.
        adjacent: (2,) int64 positions of the frames before and after c (narrow baseline).
        neighbours: (2,) int64 positions of the keyframes k1 before and k2 after c (wide baseline).
        aTc: (2, 4, 4) float64 transforms from camera c to the adjacent cameras, translation in SLAM's unit.
        kTc: (2, 4, 4) float64 transforms from camera c to the cameras of k1 and k2.
        point: (X,) int64 rows of ``SlamResult.points``, the points seen in c, k1 and k2.
        uv: (3, X, 2) float32 their pixels in c, k1 and k2, in the full-size image.
        depth: (3, X) float32 their depth in c, k1 and k2 by SLAM's map and poses, SLAM's unit.
        seen_uv: (Y, 2) float32 pixels in c, full-size image, of the points that teach c's own depth.
        seen_depth: (Y,) float32 their depth in c, SLAM's unit.
    """

    current: int
    map_id: int
    adjacent: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    aTc: Floats
    kTc: Floats
    point: NDArray[np.int64]
    uv: NDArray[np.float32]
    depth: NDArray[np.float32]
    seen_uv: NDArray[np.float32]
    seen_depth: NDArray[np.float32]

    @property
    def frames(self) -> NDArray[np.int64]:
        """The five frames of the sample, (5,): c, the adjacent two, k1 and k2."""
        return np.concatenate([[self.current], self.adjacent, self.neighbours]).astype(np.int64)


@dataclass(frozen=True)
class Supervision:
    """All that one SLAM result can teach.

    Attributes:
        camera: The camera that the samples' pixels belong to.
        samples: One per usable keyframe, in temporal order.
        keyframes: Number of keyframes that SLAM kept.
        skipped: Why the other keyframes gave no sample, reason -> number.
        observations: Number of observations before outlier removal.
        kept_observations: Number of observations after it.
    """

    camera: PinholeCamera
    samples: list[KeyframeSample]
    keyframes: int
    skipped: dict[str, int] = field(default_factory=dict)
    observations: int = 0
    kept_observations: int = 0

    @property
    def points_per_sample(self) -> float:
        """Mean number of points common to the three keyframes of a sample."""
        return float(np.mean([len(s.point) for s in self.samples])) if self.samples else 0.0

    def by_map(self) -> list[Supervision]:
        """Return one supervision per map that gave samples, with the same counts."""
        maps = dict.fromkeys(sample.map_id for sample in self.samples)
        return [replace(self, samples=[s for s in self.samples if s.map_id == map_id]) for map_id in maps]


def clean_observations(result: SlamResult, min_keyframes: int = 3, max_reprojection_error: float = 3.0) -> Observations:
    """Remove outliers as the paper does before each depth refinement.

    A point goes, with all of its keypoints, when fewer than ``min_keyframes`` keyframes observe it. An observation goes
    when its reprojection error in its own keyframe exceeds ``max_reprojection_error``. Both rules look at the map as
    SLAM left it: the observations that the second rule removes still count for the first.

    Args:
        result: SLAM's output.
        min_keyframes: Fewest keyframes that must observe a point.
        max_reprojection_error: Pixels of the full-size image.

    Returns:
        The observations that are left, in the same order.
    """
    seen = result.observations
    pairs = np.unique(np.stack([seen.point, seen.keyframe], axis=1), axis=0)
    observers = np.bincount(pairs[:, 0], minlength=len(result.points))
    keep = observers[seen.point] >= min_keyframes
    keep &= reprojection_errors(result.camera, result.keyframes, result.points, seen) <= max_reprojection_error
    return Observations(seen.keyframe[keep], seen.point[keep], seen.uv[keep], seen.depth[keep])


def measured_gap(result: SlamResult) -> int:
    """Return how many frames away the adjacent frames should be, by how far the camera moves in the depth it sees.

    Args:
        result: SLAM's output; its scale does not matter.

    Returns:
        The fewest frames in which half of the keyframes move by 1.5 % of the median depth of their points; at most 15,
        and at most as many as half of the keyframes have before the recording, or its tracking, ends.
    """
    keyframes, trajectory, seen = result.keyframes, result.trajectory, result.observations
    local = points_in_camera(keyframes.wTc[seen.keyframe], result.points.xyz[seen.point])[:, 2]
    groups = rows_by_group(seen.keyframe)
    depth = np.array([np.median(local[rows]) for rows in groups])
    frames = keyframes.frame_index[np.unique(seen.keyframe)]
    if not len(frames):
        return 1
    for gap in range(1, _WIDEST_GAP + 1):
        rows = np.searchsorted(trajectory.frame_index, np.stack([frames, frames + gap]))
        rows = np.minimum(rows, len(trajectory) - 1)
        known = (trajectory.frame_index[rows] == np.stack([frames, frames + gap])).all(axis=0) & (depth > 0)
        if known.mean() < 0.5:
            return max(1, gap - 1)
        ends = trajectory.wTc[rows[:, known], :3, 3]
        if np.median(np.linalg.norm(ends[1] - ends[0], axis=1) / depth[known]) >= _ADJACENT_PARALLAX:
            return gap
    return _WIDEST_GAP


def keyframe_samples(
    result: SlamResult,
    *,
    min_keyframes: int = 3,
    max_reprojection_error: float = 3.0,
    keyframe_gap: int = 1,
    frame_gap: int = 1,
    min_common_points: int = 20,
    consistency_points: str = "common",
    min_parallax: float = 0.0,
    far_points: str = "drop",
) -> Supervision:
    """Make one training sample of every keyframe that has neighbours on both sides.

    Points that lie farther away than anything that the depth sensor measured are left out unless ``far_points`` or
    ``min_parallax`` keeps them, which is not the paper's rule: their rays are nearly parallel, SLAM knows hardly more
    than their direction, and one of them at 10 km outweighs everything else in a loss on depth. But a network that
    predicts far things too near then never learns of them, so with ``min_parallax`` it is the points' own parallax that
    decides: on synthetic streets the depth of points beyond 40 m that was triangulated under 2 degrees and more is good
    to 5 to 7 %, where the network errs by 30 %, and the first rule drops half of them.

    Args:
        result: SLAM's output.
        min_keyframes: See ``clean_observations``.
        max_reprojection_error: See ``clean_observations``.
        keyframe_gap: How many keyframes away k1 and k2 are; 1 for the nearest. Further ones give a wider baseline and
            fewer common points.
        frame_gap: How many frames away the temporally adjacent frames are; 0 for ``measured_gap``.
        min_common_points: k1 is the nearest keyframe at ``keyframe_gap`` or beyond that shares this many points with c,
            among the next five; if none does, the one at the gap. Likewise k2. A sample without common points still
            trains by its photometric term.
        consistency_points: ``common`` teaches c's depth the points that c, k1 and k2 see (the paper), ``all`` every
            point that is left of c's: about 2.5 times as many on synthetic streets.
        min_parallax: Degrees under which a point's keyframes must see it, whatever its depth; 0 does not ask.
        far_points: What becomes of points beyond the largest depth that the sensor measured where ``min_parallax`` is
            0: ``drop``, or ``keep`` (the paper).

    Returns:
        The samples and why other keyframes gave none.
    """
    cleaned = clean_observations(result, min_keyframes, max_reprojection_error)
    views = _Views(result, cleaned, consistency_points, min_parallax, far_points)
    frame_gap = frame_gap or measured_gap(result)
    samples: list[KeyframeSample] = []
    skipped: Counter[str] = Counter()
    for row in range(len(result.keyframes)):
        k1 = views.neighbour(row, -1, keyframe_gap, min_common_points)
        k2 = views.neighbour(row, +1, keyframe_gap, min_common_points)
        adjacent = views.adjacent(row, frame_gap)
        if k1 is None:
            skipped[NO_KEYFRAME_BEFORE] += 1
        elif k2 is None:
            skipped[NO_KEYFRAME_AFTER] += 1
        elif adjacent is None:
            skipped[NO_ADJACENT_FRAME] += 1
        else:
            samples.append(views.sample(row, k1, k2, adjacent))
    return Supervision(
        camera=result.camera,
        samples=samples,
        keyframes=len(result.keyframes),
        skipped=dict(skipped),
        observations=len(result.observations),
        kept_observations=len(cleaned),
    )


class _Views:
    """The cleaned observations by keyframe, and the poses by frame."""

    def __init__(
        self,
        result: SlamResult,
        observations: Observations,
        consistency_points: str,
        min_parallax: float,
        far_points: str,
    ) -> None:
        self.result = result
        self.consistency_points = consistency_points
        self.farthest = np.inf
        self.triangulated = np.ones(len(result.points), bool)
        if min_parallax > 0:
            self.triangulated = extreme_parallax(result.keyframes, result.points, observations) >= min_parallax
        elif far_points == "drop":
            self.farthest = float(result.observations.depth.max(initial=0)) or np.inf
        order = np.lexsort((observations.point, observations.keyframe))
        bounds = np.searchsorted(observations.keyframe[order], np.arange(len(result.keyframes) + 1))
        self._point = observations.point[order]
        self._uv = observations.uv[order]
        self._slices = [slice(a, b) for a, b in itertools.pairwise(bounds)]

    def points(self, row: int) -> NDArray[np.int64]:
        """Points that keyframe ``row`` observes, ascending."""
        return self._point[self._slices[row]]

    def neighbour(self, row: int, direction: int, gap: int, min_common: int) -> int | None:
        """The row of the keyframe before (-1) or after (+1) that serves as k1 or k2, or None at the end of the map."""
        map_id = self.result.keyframes.map_id
        same = np.flatnonzero(map_id == map_id[row])
        place = int(np.searchsorted(same, row)) + direction * gap
        candidates = [int(same[p]) for p in range(place, place + 5 * direction, direction) if 0 <= p < len(same)]
        for candidate in candidates:
            if len(np.intersect1d(self.points(row), self.points(candidate))) >= min_common:
                return candidate
        return candidates[0] if candidates else None

    def adjacent(self, row: int, gap: int) -> NDArray[np.int64] | None:
        """Trajectory rows of the frames ``gap`` before and after the keyframe, or None if either cannot be used."""
        keyframes, trajectory = self.result.keyframes, self.result.trajectory
        wanted = keyframes.frame_index[row] + np.array([-gap, gap])
        at = np.searchsorted(trajectory.frame_index, wanted)
        if np.any(at >= len(trajectory)) or np.any(trajectory.frame_index[at] != wanted):
            return None
        # A frame belongs to the map of the latest keyframe before it: every map begins with a keyframe.
        owner = np.searchsorted(keyframes.frame_index, wanted, side="right") - 1
        if np.any(owner < 0) or np.any(keyframes.map_id[owner] != keyframes.map_id[row]):
            return None
        return at.astype(np.int64)

    def sample(self, row: int, k1: int, k2: int, adjacent: NDArray[np.int64]) -> KeyframeSample:
        """Put a sample together."""
        keyframes, trajectory = self.result.keyframes, self.result.trajectory
        rows = (row, k1, k2)
        common = np.intersect1d(np.intersect1d(self.points(row), self.points(k1)), self.points(k2))
        xyz = self.result.points.xyz[common]
        depth = np.stack([points_in_camera(keyframes.wTc[r], xyz)[:, 2] for r in rows])
        known = (depth <= self.farthest).all(axis=0) & self.triangulated[common]
        common, depth = common[known], depth[:, known]
        uv = np.stack([self._uv[self._slices[r]][np.searchsorted(self.points(r), common)] for r in rows])
        wTc = keyframes.wTc[row]
        seen_uv, seen_depth = self._own(row) if self.consistency_points == "all" else (uv[0], depth[0])
        return KeyframeSample(
            current=int(keyframes.frame_index[row]),
            map_id=int(keyframes.map_id[row]),
            adjacent=trajectory.frame_index[adjacent],
            neighbours=keyframes.frame_index[[k1, k2]],
            aTc=np.linalg.inv(trajectory.wTc[adjacent]) @ wTc,
            kTc=np.linalg.inv(keyframes.wTc[[k1, k2]]) @ wTc,
            point=common.astype(np.int64),
            uv=uv.astype(np.float32),
            depth=depth.astype(np.float32),
            seen_uv=seen_uv.astype(np.float32),
            seen_depth=seen_depth.astype(np.float32),
        )

    def _own(self, row: int) -> tuple[NDArray[np.float32], Floats]:
        """Pixels (Y, 2) and depth (Y,) of all reliable points that keyframe ``row`` observes."""
        points = self.points(row)
        depth = points_in_camera(self.result.keyframes.wTc[row], self.result.points.xyz[points])[:, 2]
        known = (depth <= self.farthest) & self.triangulated[points]
        return self._uv[self._slices[row]][known], depth[known]
