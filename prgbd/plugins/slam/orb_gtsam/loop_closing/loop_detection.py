"""Loop detection: which keyframes show the place of a new one, by appearance and consistency over time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.keyframe_lookup import KeyframeLookup
from prgbd.plugins.slam.orb_gtsam.map.map import Map

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

# ORB-SLAM2 (KeyFrameDatabase::DetectLoopCandidates): covisible keyframes whose scores add up, and the share of the best
# sum that a candidate needs.
_GROUP, _SHARE_OF_BEST = 10, 0.75
# Candidates that are looked at, best first: those behind them never pass the share of the best.
_CANDIDATES = 10
# ORB-SLAM2 (LoopClosing::mnCovisibilityConsistencyTh): keyframes in a row that must propose the same place.
CONSISTENCY = 3


class LoopDetector:
    """Proposes earlier keyframes, or ones of other maps, that show what a new keyframe shows.

    As ORB-SLAM2's ``LoopClosing::DetectLoop``: a candidate scores at least as well as the worst covisible neighbour,
    and neighbourhoods that overlap must be proposed at several keyframes in a row.

    Args:
        slam_map: The map.
        covisibility: Covisible keyframes.
        database: Finds keyframes by appearance.
        apart: Keyframes next to the new one in time that cannot be a loop.
        consistency: Detections in a row that are needed.
    """

    def __init__(
        self,
        slam_map: Map,
        covisibility: CovisibilityGraph,
        database: KeyframeLookup,
        apart: int,
        consistency: int = CONSISTENCY,
    ) -> None:
        self.map, self.covisibility, self.database = slam_map, covisibility, database
        self.consistency, self.apart = consistency, apart
        self._groups: list[tuple[set[int], int]] = []

    def forget(self) -> None:
        """Begin counting detections anew, after a loop was closed."""
        self._groups = []

    def propose(self, k: int) -> list[int]:
        """Return the candidates for keyframe ``k`` that were detected often enough in a row, best first."""
        proposed, groups = [], []
        for candidate in self._candidates(k):
            group = {candidate, *self.covisibility.of(candidate).tolist()}
            runs = [run for before, run in self._groups if group & before]
            run = 1 + max(runs, default=0)
            groups.append((group, run))
            if run >= self.consistency:
                proposed.append(candidate)
        self._groups = groups
        return proposed

    def _candidates(self, k: int) -> list[int]:
        """Return keyframes that look like ``k``, one of each neighbourhood, best first.

        Those that share points with the neighbourhood of ``k`` are left out: the map is already joined there.
        """
        kf = self.map.keyframes
        around = self.covisibility.of(k)
        found, scores = self.database.query(self.map.features(k).descriptor, exclude=[k])
        score = dict(zip(found.tolist(), scores.tolist(), strict=True))
        least = min((score.get(n, 0.0) for n in around.tolist()), default=0.0)
        other_map = kf.map_id[found] != kf.map_id[k]
        shared = self.covisibility.common(self.map.seen_by(np.append(around, k)))[found]
        apart = other_map | ((np.abs(found - k) > self.apart) & (shared < self.covisibility.least))
        allowed = found[~kf.bad[found] & apart & (scores >= least) & (scores > 0)][:_CANDIDATES]
        return self._best_of_groups(allowed.tolist(), score)

    def _best_of_groups(self, candidates: list[int], score: dict[int, float]) -> list[int]:
        """Add the scores of covisible candidates; keep the best of each group that comes close to the best sum."""
        known = set(candidates)
        sums: list[tuple[float, int]] = []
        for candidate in candidates:
            group = [candidate, *(n for n in self.covisibility.of(candidate)[:_GROUP].tolist() if n in known)]
            sums.append((sum(score[n] for n in group), max(group, key=lambda n: (score[n], -n))))
        if not sums:
            return []
        least = _SHARE_OF_BEST * max(total for total, _ in sums)
        kept = dict.fromkeys(n for total, n in sorted(sums, key=lambda s: (-s[0], s[1])) if total >= least)
        return list(kept)
