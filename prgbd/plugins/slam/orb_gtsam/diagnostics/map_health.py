"""Whether a finished map holds together: what shows of a wrong map without the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.core.types import SlamResult, Trajectory

# A step between neighbouring frames is a jump if it is this many times as long as the steps before and after it. In
# recordings whose trajectory was right the longest one was 4 times as long, in wrong ones 6 to 30 times.
_JUMP = 6.0
_AROUND = 8
# Shorter steps, as a share of the usual depth of the points, may be the trembling of a camera that stands.
_LEAST_STEP = 0.01
# Robust error of the keypoints after the last adjustment: right maps had 0.6 to 1.2, a wrong one 2.4.
_LARGE_ERROR = 1.7


def doubts_about(result: SlamResult, adjusted: list[dict[str, Any]]) -> list[str]:
    """Return a clause for everything that speaks against a map and its trajectory; none if it seems right.

    All frames of a wrong map may be tracked, because tracking only asks whether a frame agrees with the map.

    Args:
        result: The finished result.
        adjusted: What ``adjust_map`` said of every map.
    """
    doubts = []
    found = jumps(result.trajectory, usual_depth(result))
    if found:
        frame, factor = max(found, key=lambda jump: jump[1])
        more = f" (and at {len(found) - 1} more)" if len(found) > 1 else ""
        doubts.append(f"the camera jumps at frame {frame}{more}, {factor:.0f} times as far as in the frames around it")
    errors = [
        (2.0 * note["final_cost"] / note["observations"]) ** 0.5 for note in adjusted if note.get("observations", 0)
    ]
    if errors and max(errors) > _LARGE_ERROR:
        doubts.append(f"keypoints are {max(errors):.1f} pixels off (1 is usual)")
    return doubts


def jumps(trajectory: Trajectory, depth: float) -> list[tuple[int, float]]:
    """Return the frames that were reached by a step unlike those around it, and how many times as long it is.

    Args:
        trajectory: Final poses; only steps between frames in a row count.
        depth: Usual depth of the points, in the map's unit.
    """
    frames, centre = trajectory.frame_index, trajectory.wTc[:, :3, 3]
    order = np.argsort(frames, kind="stable")
    step = np.linalg.norm(np.diff(centre[order], axis=0), axis=1)
    step[np.diff(frames[order]) != 1] = np.nan
    found = []
    for i in np.flatnonzero(step > _LEAST_STEP * depth):
        sides = [_typical(step[max(0, i - _AROUND) : i]), _typical(step[i + 1 : i + 1 + _AROUND])]
        if step[i] > _JUMP * max(sides):
            found.append((int(frames[order][i + 1]), float(step[i] / max(*sides, 1e-12))))
    return found


def _typical(steps: NDArray[np.float64]) -> float:
    """Return the median of the known steps, infinity if there are fewer than two."""
    known = steps[np.isfinite(steps)]
    return float(np.median(known)) if len(known) > 1 else float("inf")


def usual_depth(result: SlamResult) -> float:
    """Return the median depth of the points in the keyframes that see them; 0 without any."""
    seen = result.observations
    if len(seen.keyframe) == 0:
        return 0.0
    wTc, xyz = result.keyframes.wTc[seen.keyframe], result.points.xyz[seen.point]
    return float(np.median(np.einsum("ni,ni->n", wTc[:, :3, 2], xyz - wTc[:, :3, 3])))
