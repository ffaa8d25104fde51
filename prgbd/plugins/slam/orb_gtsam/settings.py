"""Every threshold of the SLAM system in one place, with ORB-SLAM2's values as defaults."""

from __future__ import annotations

import dataclasses
import difflib
from dataclasses import dataclass
from typing import Any

import numpy as np

from prgbd.core.errors import ConfigError

# ORB-SLAM2 looks for 1000 features in 640x480 images and for 2000 in KITTI's wide ones.
_VGA_AREA = 640 * 480
_WIDE_ASPECT = 2.0


@dataclass(frozen=True)
class Settings:
    """Options of ``OrbGtsamSLAM``; each is a keyword of its constructor.

    Attributes:
        features: Keypoints per frame, or "auto": 1000 at 640x480, fewer in smaller images (with the cube root of
            the area, at least 400), 2000 in wide outdoor images (aspect > 2 and at least 1000 pixels wide).
        scale_factor: Ratio between two pyramid levels.
        levels: Number of pyramid levels.
        fast_threshold: FAST threshold tried first in every cell.
        fast_threshold_low: FAST threshold where the first finds nothing.
        cell_size: Side of the FAST cells in pixels of the level.
        init_keypoints: Keypoints needed to start, or "auto": half of ``features``, at most 500 (ORB-SLAM2), and in
            proportion to the area below 640x480.
        init_matches: Matches (and keypoints) that the two first frames of a monocular map need.
        close_depth: Depths up to this many baselines count as close (ThDepth).
        distance_high: Largest Hamming distance of a match by projection (TH_HIGH).
        distance_low: Largest Hamming distance of a match by descriptor alone (TH_LOW).
        ratio_motion: Ratio test against the previous frame.
        ratio_reference: Ratio test against the reference keyframe.
        ratio_local_map: Ratio test against the local map.
        ratio_recovery: Ratio test when tracking is recovered.
        ratio_triangulation: Ratio test when new points are triangulated.
        window_motion: Search radius in pixels at the finest level against the previous frame.
        window_local_map: Factor on the radius (2.5 or 4 pixels) against the local map with depth (1 for mono).
        min_matches_motion: Fewer matches widen the window, then give up the motion model.
        min_matches_reference: Matches needed against the reference keyframe.
        min_inliers_pose: Inliers needed after the first pose optimisation.
        min_inliers_map: Inliers needed after the local map.
        min_inliers_recovered: The same for a recovered frame.
        local_keyframes: Most keyframes of the tracker's local map.
        keyframe_min_inliers: A frame with fewer inliers is never made a keyframe ("> 15").
        keyframe_ratio: Insert when inliers fall below this share of the reference keyframe's points.
        keyframe_ratio_first: The same while there is one keyframe.
        keyframe_ratio_mono: The same for mono.
        keyframe_thin_mono: In mono, insert as well when inliers are fewer than this share of the frame's keypoints, as
            fast motion leaves few points that three keyframes see and little is expected of a frame; 0 as ORB-SLAM2.
        keyframe_close_tracked: Close points are needed when fewer than this many are tracked ...
        keyframe_close_untracked: ... and more than this many could be created.
        keyframe_min_interval: Fewest frames between two keyframes, unless tracking is weak or close points are needed.
        keyframe_points: At least this many of the closest points are created with a keyframe.
        keyframe_outliers: Whether matches that a frame's pose refutes go along into its keyframe, for bundle adjustment
            to decide about them (ORB-SLAM2), or "auto": in mono and with pseudo depth, which need them, but not where
            a sensor or a second camera measures depth, where it was better to leave them out.
        keyframe_held: Where outliers stay out of keyframes, insert as well when inliers fall below this share of all
            points that the reference keyframe holds; 0 as ORB-SLAM2.
        neighbours: Covisible keyframes for triangulation and fusion (mono: ``neighbours_mono``).
        neighbours_mono: The same for mono.
        covisible_weight: Common points that make two keyframes neighbours.
        local_ba: Whether the mapper runs local bundle adjustment.
        local_ba_keyframes: Most keyframes whose poses move in local bundle adjustment.
        local_ba_fixed: Most keyframes that hold it fixed.
        local_ba_tolerance: Relative decrease of the cost below which local bundle adjustment has converged.
        local_ba_iterations: Iterations before and after outliers are removed.
        min_found_ratio: A new point found in a smaller share of the frames that should see it is culled.
        redundancy: A keyframe is culled when more than this share of its points is seen by three others.
        stereo_gate: Whether matches must agree with the measured depth (right-image coordinate), as in ORB-SLAM2.
        depth_trust: Depths beyond this many baselines make no stereo observation (the keypoint stays monocular);
            0 trusts all depths, as ORB-SLAM2 does.
        realtime: Whether the mapper works in a thread beside the tracker; faster, but no two runs are quite alike.
        realtime_queue: Most keyframes that wait while that mapper is busy; one more makes the tracker wait as well.
        depth_sigma: Standard deviation of a measured depth as a share of it, or "auto": 0 for a sensor (its error is
            that of a keypoint, as in ORB-SLAM2), 0.15 for pseudo depth.
        depth_sigma_far: Growth of that share per baseline of depth.
        depth_shared: Observations whose depths err together; the optimisers divide the depths' weight by it. "auto": 1
            for a sensor; half of ``features`` for pseudo depth, so that a frame's depths count about as one.
        depth_fallback: Whether observations whose depth disagrees go on as monocular ones instead of being outliers,
            or "auto": for pseudo depth only.
        depth_border: Keypoints whose surrounding depth differs by more than this share make no stereo observation; 0
            allows any.
        recovery_keyframes: Keyframes of any map that are tried for a lost frame.
        restart_after: A new map may start after this many lost frames that showed something but no known place (each
            further frame is looked for in the old maps first); at once with <= ``restart_keyframes`` keyframes.
        restart_keyframes: See ``restart_after``.
        restart_extrapolate: After at most this many lost frames a new map with measured depth begins where the camera
            would be had it gone on as before; else where it was last seen.
        loop_closing: Whether loops are closed and maps of one place joined.
        loop_scale: Whether a loop corrects scale: "free", "fixed", or "auto": free in mono; where depth is measured
            fixed, and free (0.5 to 2) where the depth proves to have drifted in scale, as a network's can.
        loop_min_interval: Keyframes between two loops, and between the two ends of one.
        loop_consistency: Keyframes in a row that must propose the same place.
        loop_ratio: Ratio test between the keyframes of a loop.
        loop_min_inliers: Inliers that the similarity between the two keyframes needs.
        loop_min_matches: Points around the loop keyframe that must be found in the new one.
        essential_weight: Common points that make an edge of the essential graph.
        loop_ba: Whether a loop is followed by a bundle adjustment of its map (up to ``full_ba_keyframes``).
        focal_length_sigma: Relative standard deviation of the camera's focal length. A map of mono or pseudo depth
            whose pixels know it four times better and contradict it by 1.5 such deviations refines it with all poses
            and points before the last bundle adjustment, and the result names the refined camera. 0 keeps the focal
            length, as ORB-SLAM2 does.
        full_ba: Whether ``finish`` runs a bundle adjustment over the whole map.
        full_ba_iterations: Its iterations.
        full_ba_backend: Solver of all bundle adjustments, "numba" or "gtsam"; both reach the same optimum, numba about
            ten times faster at 200 keyframes.
        full_ba_keyframes: Maps with more keyframes skip it, with a note in the statistics.
    """

    features: int | str = "auto"
    scale_factor: float = 1.2
    levels: int = 8
    fast_threshold: int = 20
    fast_threshold_low: int = 7
    cell_size: int = 30
    init_keypoints: int | str = "auto"
    init_matches: int = 100
    close_depth: float = 40.0
    distance_high: int = 100
    distance_low: int = 50
    ratio_motion: float = 0.9
    ratio_reference: float = 0.7
    ratio_local_map: float = 0.8
    ratio_recovery: float = 0.75
    ratio_triangulation: float = 0.6
    window_motion: float = 15.0
    window_local_map: float = 3.0
    min_matches_motion: int = 20
    min_matches_reference: int = 15
    min_inliers_pose: int = 10
    min_inliers_map: int = 30
    min_inliers_recovered: int = 50
    local_keyframes: int = 80
    keyframe_min_inliers: int = 15
    keyframe_ratio: float = 0.75
    keyframe_ratio_first: float = 0.4
    keyframe_ratio_mono: float = 0.9
    keyframe_thin_mono: float = 0.15
    keyframe_close_tracked: int = 100
    keyframe_close_untracked: int = 70
    keyframe_min_interval: int = 0
    keyframe_points: int = 100
    keyframe_outliers: bool | str = "auto"
    keyframe_held: float = 0.25
    neighbours: int = 10
    neighbours_mono: int = 20
    covisible_weight: int = 15
    local_ba: bool = True
    local_ba_keyframes: int = 20
    local_ba_fixed: int = 30
    local_ba_tolerance: float = 1e-3
    local_ba_iterations: tuple[int, int] = (5, 10)
    min_found_ratio: float = 0.25
    redundancy: float = 0.9
    stereo_gate: bool = True
    depth_trust: float = 0.0
    realtime: bool = False
    realtime_queue: int = 0
    depth_sigma: float | str = "auto"
    depth_sigma_far: float = 0.0
    depth_shared: float | str = "auto"
    depth_fallback: bool | str = "auto"
    depth_border: float = 0.0
    recovery_keyframes: int = 12
    restart_after: int = 10
    restart_keyframes: int = 5
    restart_extrapolate: int = 60
    loop_closing: bool = True
    loop_scale: str = "auto"
    loop_min_interval: int = 10
    loop_consistency: int = 3
    loop_ratio: float = 0.75
    loop_min_inliers: int = 20
    loop_min_matches: int = 40
    essential_weight: int = 100
    loop_ba: bool = True
    focal_length_sigma: float = 0.01
    localise_only: bool = False
    full_ba: bool = True
    full_ba_iterations: int = 10
    full_ba_backend: str = "numba"
    full_ba_keyframes: int = 300

    def __post_init__(self) -> None:
        self._check_depth()
        for name in ("features", "init_keypoints"):
            value = getattr(self, name)
            if value != "auto" and (isinstance(value, str) or int(value) < 1):
                raise ConfigError(f"slam.{name} must be 'auto' or a positive number, got {value!r}.")
        if not self.scale_factor > 1.0 or not 1 <= self.levels <= 16:
            raise ConfigError(
                f"slam.scale_factor must exceed 1 and slam.levels lie in 1..16, got "
                f"{self.scale_factor} and {self.levels}."
            )
        if not 0 <= self.keyframe_held <= 1:
            raise ConfigError(f"slam.keyframe_held must lie in 0..1, got {self.keyframe_held}.")
        if not 0 < self.fast_threshold_low <= self.fast_threshold < 255:
            raise ConfigError(
                "slam.fast_threshold_low must be positive and at most slam.fast_threshold (< 255), got "
                f"{self.fast_threshold_low} and {self.fast_threshold}."
            )
        if self.loop_scale not in ("auto", "free", "fixed"):
            raise ConfigError(f"slam.loop_scale must be 'auto', 'free' or 'fixed', got {self.loop_scale!r}.")
        if self.full_ba_backend not in ("gtsam", "numba"):
            raise ConfigError(f"slam.full_ba_backend must be 'gtsam' or 'numba', got {self.full_ba_backend!r}.")

    def _check_depth(self) -> None:
        for name, least in (("depth_sigma", 0), ("depth_shared", 1)):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if value != "auto" and not (number and np.isfinite(value) and value >= least):
                raise ConfigError(f"slam.{name} must be 'auto' or a number of at least {least}, got {value!r}.")
        for name in ("depth_fallback", "keyframe_outliers"):
            if (value := getattr(self, name)) not in ("auto", True, False):
                raise ConfigError(f"slam.{name} must be 'auto', true or false, got {value!r}.")

    def takes_outliers(self, mode: str) -> bool:
        """Say whether keyframes take refuted matches along in a mode of the system."""
        auto = self.keyframe_outliers == "auto"
        return mode not in ("rgbd", "stereo") if auto else bool(self.keyframe_outliers)

    @classmethod
    def from_options(cls, options: dict[str, Any]) -> Settings:
        """Make settings from keyword options.

        Raises:
            ConfigError: If an option does not exist (the message names the nearest ones) or has a wrong type.
        """
        fields = {field.name: field for field in dataclasses.fields(cls)}
        values: dict[str, Any] = {}
        for name, value in options.items():
            if name not in fields:
                near = difflib.get_close_matches(name, list(fields), n=3, cutoff=0.5)
                hint = "did you mean " + ", ".join(f"'{n}'" for n in near) + "?" if near else "see Settings for all."
                raise ConfigError(f"The SLAM plug-in 'orb_gtsam' has no option '{name}'; {hint}")
            values[name] = _converted(name, value, fields[name].default)
        return cls(**values)

    def feature_count(self, width: int, height: int) -> int:
        """Return the number of keypoints to look for in images of ``width`` x ``height`` pixels."""
        if self.features != "auto":
            return int(self.features)
        if width >= 1000 and width > _WIDE_ASPECT * height:
            return 2000
        return max(400, round(1000 * min(1.0, width * height / _VGA_AREA) ** (1.0 / 3.0)))

    def keypoints_to_start(self, width: int, height: int) -> int:
        """Return the number of keypoints that a first frame must have."""
        if self.init_keypoints != "auto":
            return int(self.init_keypoints)
        area = min(1.0, width * height / _VGA_AREA)
        return int(min(500, 0.5 * self.feature_count(width, height)) * area)

    def scales(self) -> np.ndarray:
        """Return the scale of every pyramid level, (levels,) float64, finest first."""
        return self.scale_factor ** np.arange(self.levels, dtype=np.float64)


def _converted(name: str, value: Any, default: Any) -> Any:
    """Give ``value`` the type of ``default``, so that YAML's 1 serves where 1.0 is meant."""
    kind = type(default)
    try:
        if kind is tuple:
            converted = tuple(int(v) for v in value)
            if len(converted) != len(default):
                raise ValueError
            return converted
        if kind is str:
            return value
        if kind is bool:
            if not isinstance(value, bool):
                raise ValueError
            return value
        number = kind(value)
        if not np.isfinite(number) or number < 0 or (kind is int and number != float(value)):
            raise ValueError
        return number
    except (TypeError, ValueError):
        wanted = {bool: "true or false", int: "a whole number", float: "a number"}
        expected = wanted.get(kind, f"like {default}")
        raise ConfigError(f"slam.{name} must be {expected}, not negative, got {value!r}.") from None
