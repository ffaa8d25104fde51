"""The options of the SLAM system, grouped by room; ORB-SLAM2's values unless an attribute says otherwise.

Thresholds that nobody sets are constants beside their algorithm. Nothing heavy is imported here, so that the command
line can list the options without loading the system.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from prgbd.core.errors import ConfigError
from prgbd.core.option_ranges import CountOrZero, NotNegative, Range, Share
from prgbd.core.options import check_types, from_mapping
from prgbd.plugins.slam.orb_gtsam.former_options import refuse_former_options

Auto = Literal["auto"]
# More keypoints than this would take gigabytes for the columns of the map.
KeypointCount = Annotated[int, Range(1, 100_000)]
Solver = Literal["numba", "gtsam"]
AUTO: Final = "auto"
# ORB-SLAM2 looks for 1000 features in 640x480 images (TUM1.yaml) and for 2000 in KITTI's wide ones (KITTI00-02.yaml).
VGA_AREA = 640 * 480
_WIDE_ASPECT = 2.0


@dataclass(frozen=True)
class FeatureOptions:
    """ORB keypoints: ``slam.features.*``.

    Attributes:
        count: Keypoints per frame, or "auto": 1000 at 640x480, fewer in smaller images (with the cube root of the
            area, at least 400), 2000 in wide outdoor images (aspect > 2 and at least 1000 pixels wide).
        scale_factor: Ratio between two pyramid levels.
        levels: Number of pyramid levels.
        fast_threshold: FAST threshold tried first in every cell.
        fast_threshold_low: FAST threshold where the first finds nothing.
        align: Whether keypoints of keyframes are moved to where the patches around them agree, and are hardly believed
            where they do not, or "auto": in mono and with pseudo depth, whose maps shrink without it where the camera
            drives forward, but not where a sensor or a second camera holds the scale; false as ORB-SLAM2.
    """

    count: KeypointCount | Auto = AUTO
    scale_factor: Annotated[float, Range(1, 10, without=1)] = 1.2
    levels: Annotated[int, Range(1, 16)] = 8
    fast_threshold: Annotated[int, Range(1, 254)] = 20
    fast_threshold_low: Annotated[int, Range(1, 254)] = 7
    align: bool | Auto = AUTO

    def __post_init__(self) -> None:
        check_types(self, "slam.features")
        if self.fast_threshold_low > self.fast_threshold:
            raise ConfigError(
                f"slam.features.fast_threshold_low is {self.fast_threshold_low}; it must be at most "
                f"slam.features.fast_threshold={self.fast_threshold}."
            )

    def aligns(self, mode: str) -> bool:
        """Say whether keypoints are aligned in a mode of the system."""
        return mode not in ("rgbd", "stereo") if self.align == AUTO else self.align

    def count_in(self, width: int, height: int) -> int:
        """Return the number of keypoints to look for in images of ``width`` x ``height`` pixels."""
        if self.count != AUTO:
            return self.count
        if width >= 1000 and width > _WIDE_ASPECT * height:
            return 2000
        return max(400, round(1000 * min(1.0, width * height / VGA_AREA) ** (1.0 / 3.0)))

    def scales(self) -> NDArray[np.float64]:
        """Return the scale of every pyramid level, (levels,) float64, finest first."""
        return self.scale_factor ** np.arange(self.levels, dtype=np.float64)


@dataclass(frozen=True)
class TrackingOptions:
    """Frames in the map, and what happens when they are lost: ``slam.tracking.*``.

    Attributes:
        local_keyframes: Most keyframes of the tracker's local map.
        min_inliers_recovered: Inliers that a recovered frame needs after the local map.
        recovery_keyframes: Keyframes of any map that are tried for a lost frame.
        restart_after: A new map may start after this many lost frames that showed something but no known place (each
            further frame is looked for in the old maps first); at once with <= ``restart_keyframes`` keyframes.
        restart_keyframes: See ``restart_after``.
        restart_extrapolate: After at most this many lost frames a new map with measured depth begins where the camera
            would be had it gone on as before; else where it was last seen.
    """

    local_keyframes: CountOrZero = 80
    min_inliers_recovered: CountOrZero = 50
    recovery_keyframes: CountOrZero = 12
    restart_after: CountOrZero = 10
    restart_keyframes: CountOrZero = 5
    restart_extrapolate: CountOrZero = 60

    def __post_init__(self) -> None:
        check_types(self, "slam.tracking")


@dataclass(frozen=True)
class KeyframeOptions:
    """When a frame becomes a keyframe, and what it takes along: ``slam.keyframes.*``.

    Attributes:
        ratio: Insert when inliers fall below this share of the reference keyframe's points.
        ratio_first: The same while there is one keyframe.
        ratio_mono: The same for mono.
        ratio_pseudo: The same for pseudo depth, whose aligned keypoints last longer than ORB-SLAM2's.
        thin_mono: In mono, insert as well when inliers are fewer than this share of the frame's keypoints, as fast
            motion leaves few points that three keyframes see and little is expected of a frame; 0 as ORB-SLAM2.
        close_tracked: With measured depth, insert as well when fewer close points than this are tracked and enough
            could be created.
        min_interval: Fewest frames between two keyframes, unless tracking is weak or close points are needed.
        outliers: Whether matches that a frame's pose refutes go along into its keyframe, for bundle adjustment to
            decide about them (ORB-SLAM2), or "auto": in mono and with pseudo depth, which need them, but not where a
            sensor or a second camera measures depth, where it was better to leave them out.
        held: Where outliers stay out of keyframes, insert as well when inliers fall below this share of all points
            that the reference keyframe holds; 0 as ORB-SLAM2.
    """

    ratio: NotNegative = 0.75
    ratio_first: NotNegative = 0.4
    ratio_mono: NotNegative = 0.9
    ratio_pseudo: NotNegative = 0.7
    thin_mono: NotNegative = 0.15
    close_tracked: CountOrZero = 100
    min_interval: CountOrZero = 0
    outliers: bool | Auto = AUTO
    held: Share = 0.25

    def __post_init__(self) -> None:
        check_types(self, "slam.keyframes")

    def take_outliers(self, mode: str) -> bool:
        """Say whether keyframes take refuted matches along in a mode of the system."""
        return mode not in ("rgbd", "stereo") if self.outliers == AUTO else self.outliers


@dataclass(frozen=True)
class MappingOptions:
    """What happens to the map after a keyframe: ``slam.mapping.*``.

    Attributes:
        neighbours: Covisible keyframes for triangulation and the merging of points, or "auto": 10, and 20 in mono.
        redundancy: A keyframe is culled when more than this share of its points is seen by three others.
        queue: Most keyframes that wait while the mapper of ``slam.realtime`` is busy; one more makes the tracker wait
            as well.
    """

    neighbours: CountOrZero | Auto = AUTO
    redundancy: NotNegative = 0.9
    queue: CountOrZero = 0

    def __post_init__(self) -> None:
        check_types(self, "slam.mapping")

    def neighbours_in(self, *, mono: bool) -> int:
        """Return the number of covisible keyframes to work with."""
        if self.neighbours != AUTO:
            return self.neighbours
        return 20 if mono else 10


@dataclass(frozen=True)
class LoopClosingOptions:
    """Places that are seen again: ``slam.loop_closing.*``.

    Attributes:
        enabled: Whether loops are closed and maps of one place joined.
        scale: Whether a loop corrects scale: "free", "fixed", or "auto": free in mono; where depth is measured fixed,
            and free (0.5 to 2) where the depth proves to have drifted in scale, as a network's can.
        min_interval: Keyframes between two loops, and between the two ends of one.
        bundle_adjustment: Whether a loop is followed by a bundle adjustment of its map (up to
            ``slam.optimisation.full_ba_keyframes``).
    """

    enabled: bool = True
    scale: Literal["auto", "free", "fixed"] = AUTO
    min_interval: CountOrZero = 10
    bundle_adjustment: bool = True

    def __post_init__(self) -> None:
        check_types(self, "slam.loop_closing")


@dataclass(frozen=True)
class DepthOptions:
    """What a measured depth counts: ``slam.depth.*``.

    Attributes:
        close: Depths up to this many baselines count as close (ThDepth).
        trust: Depths beyond this many baselines make no stereo observation (the keypoint stays monocular); 0 trusts
            all depths, as ORB-SLAM2 does.
        gate: Whether matches must agree with the measured depth (right-image coordinate), as in ORB-SLAM2.
        sigma: Standard deviation of a measured depth as a share of it, or "auto": 0 for a sensor (its error is that of
            a keypoint, as in ORB-SLAM2), 0.15 for pseudo depth.
        sigma_far: Growth of that share per baseline of depth.
        follow: Whether every frame's depth is divided by its scale against the map, so that geometry holds the scale
            from keyframe to keyframe, and the drift that it leaves is taken out at the end, as far as the covariance
            of bundle adjustment allows and the depth of all keyframes together tells; or "auto": for pseudo depth,
            whose scale wanders, unless ``shared`` says what it counts. false takes depth as it is, as the paper
            does, and weighs it by ``sigma`` and ``shared``.
        shared: Observations whose depths err together; the optimisers divide the depths' weight by it. "auto": 1 for a
            sensor; so many where depth follows the map that it has no say about poses; for pseudo depth that does
            not, half of the keypoints of a frame, so that a frame's depths count about as one.
        fallback: Whether observations whose depth disagrees go on as monocular ones instead of being outliers, or
            "auto": for pseudo depth only.
        border: Keypoints whose surrounding depth differs by more than this share make no stereo observation; 0 allows
            any.
    """

    close: NotNegative = 40.0
    trust: NotNegative = 0.0
    gate: bool = True
    sigma: NotNegative | Auto = AUTO
    sigma_far: NotNegative = 0.0
    follow: bool | Auto = AUTO
    shared: Annotated[float, Range(1)] | Auto = AUTO
    fallback: bool | Auto = AUTO
    border: NotNegative = 0.0

    def __post_init__(self) -> None:
        check_types(self, "slam.depth")

    def follows(self, mode: str) -> bool:
        """Say whether depth follows the scale of the map in a mode of the system."""
        if self.follow == AUTO:
            return mode == "pseudo_rgbd" and self.shared == AUTO
        return self.follow and mode in ("rgbd", "pseudo_rgbd")


@dataclass(frozen=True)
class OptimisationOptions:
    """Bundle adjustment: ``slam.optimisation.*``.

    Attributes:
        solver: Solver of all bundle adjustments, "numba" or "gtsam"; both reach the same optimum, numba about ten
            times faster at 200 keyframes. ``slam.solver`` is short for it.
        local_ba: Whether the mapper runs local bundle adjustment.
        local_ba_keyframes: Most keyframes whose poses move in it.
        full_ba: Whether ``finish`` runs a bundle adjustment over the whole map.
        full_ba_keyframes: Maps with more keyframes skip it, with a note in the statistics.
        focal_length_sigma: Relative standard deviation of the camera's focal length. A map of mono or pseudo depth
            whose pixels know it four times better and contradict it by 1.5 such deviations refines it with all poses
            and points before the last bundle adjustment, and the result names the refined camera. 0 keeps the focal
            length, as ORB-SLAM2 does. Where the images' radial distortion explains the map without another focal
            length, that is refined instead.
    """

    solver: Solver = "numba"
    local_ba: bool = True
    local_ba_keyframes: CountOrZero = 20
    full_ba: bool = True
    full_ba_keyframes: CountOrZero = 300
    focal_length_sigma: NotNegative = 0.01

    def __post_init__(self) -> None:
        check_types(self, "slam.optimisation")


@dataclass(frozen=True)
class Settings:
    """Options of ``OrbGtsamSLAM``; each is a keyword of its constructor, the groups as mappings or as their classes.

    Attributes:
        realtime: Whether the mapper works in a thread beside the tracker; faster, but no two runs are quite alike.
        localise_only: Only localise in a loaded map (``slam.load_map``): no new keyframes, and the map stays as it is.
        features: Keypoints.
        tracking: Frames in the map.
        keyframes: When a frame becomes a keyframe.
        mapping: The map after a keyframe.
        loop_closing: Places that are seen again.
        depth: What a measured depth counts.
        optimisation: Bundle adjustment.
    """

    realtime: bool = False
    localise_only: bool = False
    features: FeatureOptions = field(default_factory=FeatureOptions)
    tracking: TrackingOptions = field(default_factory=TrackingOptions)
    keyframes: KeyframeOptions = field(default_factory=KeyframeOptions)
    mapping: MappingOptions = field(default_factory=MappingOptions)
    loop_closing: LoopClosingOptions = field(default_factory=LoopClosingOptions)
    depth: DepthOptions = field(default_factory=DepthOptions)
    optimisation: OptimisationOptions = field(default_factory=OptimisationOptions)

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Settings:
        """Make settings from keyword options, the groups as mappings or as their classes.

        Raises:
            ConfigError: If an option does not exist (the message names the nearest ones), has a wrong type or a value
                out of range, or is a former name (the message names the present one).
        """
        refuse_former_options(options)
        given = dict(options)
        solver = given.pop("solver", None)
        settings = from_mapping(cls, given, "slam")
        if solver is None:
            return settings
        optimisation = vars(settings.optimisation) | {"solver": solver}
        return replace(settings, optimisation=from_mapping(OptimisationOptions, optimisation, "slam.optimisation"))
