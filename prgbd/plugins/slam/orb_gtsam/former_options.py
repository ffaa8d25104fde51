"""Where the options went that had flat names before they were grouped by room."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from prgbd.core.errors import ConfigError

# Former name: present one, or the file and name of the constant that it became.
FORMER_OPTIONS = {
    "features": "features.count",
    "scale_factor": "features.scale_factor",
    "levels": "features.levels",
    "fast_threshold": "features.fast_threshold",
    "fast_threshold_low": "features.fast_threshold_low",
    "cell_size": "features/extraction.py:CELL_SIZE",
    "init_keypoints": "tracking/initializer.py:keypoints_to_start",
    "init_matches": "tracking/two_view_initializer.py:LEAST_MATCHES",
    "close_depth": "depth.close",
    "distance_high": "features/matching.py:DISTANCE_HIGH",
    "distance_low": "features/matching.py:DISTANCE_LOW",
    "ratio_motion": "tracking/tracker.py:RATIO_MOTION",
    "ratio_reference": "tracking/tracker.py:RATIO_REFERENCE",
    "ratio_local_map": "tracking/local_map.py:RATIO",
    "ratio_recovery": "tracking/relocalisation.py:RATIO",
    "ratio_triangulation": "mapping/triangulation.py:RATIO",
    "window_motion": "tracking/tracker.py:WINDOW_MOTION",
    "window_local_map": "tracking/tracker.py:FACTOR_WITH_DEPTH",
    "min_matches_motion": "tracking/tracker.py:MIN_MATCHES_MOTION",
    "min_matches_reference": "tracking/tracker.py:MIN_MATCHES_REFERENCE",
    "min_inliers_pose": "tracking/tracker.py:MIN_INLIERS_POSE",
    "min_inliers_map": "tracking/tracker.py:MIN_INLIERS_MAP",
    "min_inliers_recovered": "tracking.min_inliers_recovered",
    "local_keyframes": "tracking.local_keyframes",
    "keyframe_min_inliers": "tracking/keyframe_decision.py:MIN_INLIERS",
    "keyframe_ratio": "keyframes.ratio",
    "keyframe_ratio_first": "keyframes.ratio_first",
    "keyframe_ratio_mono": "keyframes.ratio_mono",
    "keyframe_thin_mono": "keyframes.thin_mono",
    "keyframe_close_tracked": "keyframes.close_tracked",
    "keyframe_close_untracked": "tracking/keyframe_decision.py:CLOSE_UNTRACKED",
    "keyframe_min_interval": "keyframes.min_interval",
    "keyframe_points": "map/keyframe_creation.py:CLOSEST_LIFTED",
    "keyframe_outliers": "keyframes.outliers",
    "keyframe_held": "keyframes.held",
    "neighbours": "mapping.neighbours",
    "neighbours_mono": "mapping.neighbours",
    "covisible_weight": "map/covisibility.py:LEAST_COMMON",
    "local_ba": "optimisation.local_ba",
    "local_ba_keyframes": "optimisation.local_ba_keyframes",
    "local_ba_fixed": "map/adjustment.py:FIXED_KEYFRAMES",
    "local_ba_tolerance": "map/adjustment.py:TOLERANCE",
    "local_ba_iterations": "map/adjustment.py:LOCAL_ITERATIONS",
    "min_found_ratio": "map/culling.py:MIN_FOUND_RATIO",
    "redundancy": "mapping.redundancy",
    "stereo_gate": "depth.gate",
    "depth_trust": "depth.trust",
    "realtime_queue": "mapping.queue",
    "depth_sigma": "depth.sigma",
    "depth_sigma_far": "depth.sigma_far",
    "depth_shared": "depth.shared",
    "depth_fallback": "depth.fallback",
    "depth_border": "depth.border",
    "recovery_keyframes": "tracking.recovery_keyframes",
    "restart_after": "tracking.restart_after",
    "restart_keyframes": "tracking.restart_keyframes",
    "restart_extrapolate": "tracking.restart_extrapolate",
    "loop_closing": "loop_closing.enabled",
    "loop_scale": "loop_closing.scale",
    "loop_min_interval": "loop_closing.min_interval",
    "loop_consistency": "loop_closing/loop_detection.py:CONSISTENCY",
    "loop_ratio": "loop_closing/loop_verification.py:RATIO",
    "loop_min_inliers": "loop_closing/loop_verification.py:MIN_INLIERS",
    "loop_min_matches": "loop_closing/loop_verification.py:MIN_MATCHES",
    "essential_weight": "loop_closing/loop_correction.py:ESSENTIAL_WEIGHT",
    "loop_ba": "loop_closing.bundle_adjustment",
    "focal_length_sigma": "optimisation.focal_length_sigma",
    "full_ba": "optimisation.full_ba",
    "full_ba_iterations": "map/adjustment.py:GLOBAL_ITERATIONS",
    "full_ba_backend": "optimisation.solver",
    "full_ba_keyframes": "optimisation.full_ba_keyframes",
}
# Former options whose name is a group's now: only a plain value in their place is meant for the option.
_GROUPS_NOW = ("features", "loop_closing")
_FOLDER = "prgbd/plugins/slam/orb_gtsam"


def refuse_former_options(options: Mapping[str, Any]) -> None:
    """Refuse options by a former name.

    Raises:
        ConfigError: If there is one; the message names the present option, or the constant.
    """
    for name, value in options.items():
        if name not in FORMER_OPTIONS or (name in _GROUPS_NOW and not isinstance(value, bool | int | float | str)):
            continue
        now = FORMER_OPTIONS[name]
        if ":" in now:
            file, _, constant = now.partition(":")
            raise ConfigError(
                f"slam.{name} is no option any more but fixed: {constant} in {_FOLDER}/{file}; leave it out."
            )
        raise ConfigError(f"slam.{name} is called slam.{now} now; write slam.{now}={_as_typed(value)}.")


def _as_typed(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
