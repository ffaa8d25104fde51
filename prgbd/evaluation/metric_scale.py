"""Whether a metric trajectory has the scale that it claims: against true poses, and against its own triangulation.

The poses of RGB-D and stereo SLAM get their scale from the measured depth or the baseline alone. A wrong unit makes
poses and points wrong together, so that nothing but true poses shows it. Triangulation with those poses shows what is
wrong within: depth that is not registered to the images, or does not go with their focal length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prgbd.core.alignment import fit_alignment
from prgbd.core.types import SlamResult
from prgbd.evaluation.triangulated_depth import triangulated_ratios

METRIC_MODES = ("rgbd", "stereo")
RIGHT = (0.8, 1.25)  # a scale within is not worth a word
FEWEST_POSES = 10
FEWEST_POINTS = 100
FITS = 0.3  # of the extent of the true path may be left over, for its scale to mean anything
COMMON_LEVELS = (1.0, 100.0, 256.0, 1000.0, 5000.0, 10000.0)  # grey levels in a metre that sensors and programs write
NEAR = 0.1  # relative difference from one of them


def scale_doubts(
    result: SlamResult, truth_wTc: NDArray[np.float64] | None, levels_per_metre: float | None = None
) -> list[str]:
    """Return what speaks against the scale of a trajectory on measured depth or stereo images, in clauses.

    Args:
        result: SLAM's output; one of another mode, whose scale is free, has no doubts.
        truth_wTc: (frames, 4, 4) true poses, NaN where unknown, or None.
        levels_per_metre: Of the recording's depth files, where known, for the mend.
    """
    if result.mode not in METRIC_MODES or "pseudo_depth" in result.stats:
        return []
    doubts = []
    scale = None if truth_wTc is None else true_scale(result, truth_wTc)
    if scale is not None and not RIGHT[0] <= scale <= RIGHT[1]:
        doubts.append(_against_truth(scale, result.mode, levels_per_metre))
    ratios = triangulated_ratios(result, result.observations)
    ratio = float(np.median(ratios)) if len(ratios) >= FEWEST_POINTS else 1.0
    if not RIGHT[0] <= ratio <= RIGHT[1]:
        measured = "the measured depth" if result.mode == "rgbd" else "the depth of the right images"
        mend = "that depth is registered to the images, and the" if result.mode == "rgbd" else "the baseline and the"
        doubts.append(f"{measured} is {_times(ratio)} triangulated depth; check {mend} focal length")
    return doubts


def true_scale(result: SlamResult, truth_wTc: NDArray[np.float64]) -> float | None:
    """Return the factor that the trajectory must be multiplied by to fit the true poses.

    Returns:
        None where it means nothing: few poses, a camera that hardly moves, or a path of another form.
    """
    frames = result.trajectory.frame_index
    truth = np.asarray(truth_wTc, np.float64)[frames]
    known = np.isfinite(truth).all(axis=(1, 2))
    if np.count_nonzero(known) < FEWEST_POSES:
        return None
    estimate, truth = result.trajectory.positions[known], truth[known, :3, 3]
    extent = float(np.sqrt(np.square(truth - truth.mean(axis=0)).sum(axis=1).mean()))
    fit = fit_alignment(estimate, truth)
    left = float(np.sqrt(np.square(fit.points(estimate) - truth).sum(axis=1).mean()))
    return fit.scale if left < FITS * extent else None


def _against_truth(scale: float, mode: str, levels_per_metre: float | None) -> str:
    size = f"{scale:.3g} times too small" if scale > 1 else f"{1 / scale:.3g} times too large"
    if mode == "stereo":
        return f"the trajectory is {size} against the true poses: check the baseline of the right images"
    said = f"the depth is {size} against the true poses"
    if levels_per_metre is None:
        return f"{said}: check its unit"
    wanted = levels_per_metre / scale
    likely = next((levels for levels in COMMON_LEVELS if abs(wanted / levels - 1) < NEAR), wanted)
    return f"{said}: check data.depth_levels_per_metre, {likely:.4g} in place of {levels_per_metre:.4g}"


def _times(ratio: float) -> str:
    return f"{ratio:.2f} times the"
