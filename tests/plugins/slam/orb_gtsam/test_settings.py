"""Options of ``orb_gtsam``."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import prgbd
from prgbd.core.errors import ConfigError
from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam import orb_gtsam
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.former_options import FORMER_OPTIONS
from prgbd.plugins.slam.orb_gtsam.settings import (
    FeatureOptions,
    KeyframeOptions,
    OptimisationOptions,
    Settings,
    TrackingOptions,
)
from prgbd.plugins.slam.orb_gtsam.tracking.initializer import keypoints_to_start


def test_groups_are_given_as_mappings_or_as_their_classes() -> None:
    by_mapping = OrbGtsamSLAM(tracking={"local_keyframes": 40}, realtime=True).settings
    by_class = OrbGtsamSLAM(tracking=TrackingOptions(local_keyframes=40), realtime=True).settings
    assert by_mapping == by_class == Settings(realtime=True, tracking=TrackingOptions(local_keyframes=40))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"feature": 500}, "slam.features"),
        ({"tracking": {"local_keyframe": 40}}, "slam.tracking.local_keyframes"),
        ({"tracking": {"ratio_mono": 0.9}}, "slam.keyframes.ratio_mono"),
        ({"solvr": "gtsam"}, "slam.optimisation.solver"),
    ],
)
def test_an_unknown_option_names_the_nearest(options, named) -> None:
    with pytest.raises(ConfigError, match=rf"no option 'slam\.[\w.]+'; .*{named}"):
        OrbGtsamSLAM(**options)


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        ("features", "count", 0),
        ("features", "count", "many"),
        ("features", "count", 2.5),
        ("features", "levels", 0),
        ("features", "levels", 2.5),
        ("features", "scale_factor", 1.0),
        ("features", "fast_threshold_low", 25),
        ("tracking", "recovery_keyframes", None),
        ("tracking", "restart_after", -1),
        ("keyframes", "ratio", -0.5),
        ("keyframes", "ratio", float("inf")),
        ("keyframes", "outliers", "maybe"),
        ("keyframes", "held", 1.1),
        ("keyframes", "held", float("nan")),
        ("mapping", "redundancy", float("nan")),
        ("mapping", "neighbours", "few"),
        ("loop_closing", "scale", "loose"),
        ("depth", "sigma", -0.1),
        ("depth", "sigma", "much"),
        ("depth", "shared", 0.5),
        ("depth", "fallback", "maybe"),
        ("optimisation", "local_ba", "maybe"),
        ("optimisation", "solver", "ceres"),
    ],
)
def test_a_bad_value_is_named(group, name, value) -> None:
    with pytest.raises(ConfigError, match=rf"^slam\.{group}\.{name}\b.*\.$"):
        OrbGtsamSLAM(**{group: {name: value}})


def test_a_class_checks_types_and_ranges() -> None:
    with pytest.raises(ConfigError, match=r"slam\.features\.count is 'many'"):
        FeatureOptions(count="many")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"slam\.keyframes\.outliers is 'maybe'"):
        KeyframeOptions(outliers="maybe")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"slam\.features\.fast_threshold_low is 25"):
        FeatureOptions(fast_threshold_low=25)


def test_a_plain_value_is_no_group() -> None:
    with pytest.raises(ConfigError, match=r"slam\.tracking"):
        OrbGtsamSLAM(tracking=40)


def test_values_from_yaml_take_the_right_type() -> None:
    settings = Settings.from_options({"depth": {"close": 35, "shared": 1}, "features": {"count": 800}})
    assert (settings.depth.close, settings.depth.shared, settings.features.count) == (35.0, 1.0, 800)
    assert isinstance(settings.depth.close, float)


@pytest.mark.parametrize(
    ("name", "value", "now"),
    [
        ("keyframe_ratio", 0.8, "slam.keyframes.ratio=0.8"),
        ("features", 500, "slam.features.count=500"),
        ("features", "auto", "slam.features.count=auto"),
        ("loop_closing", False, "slam.loop_closing.enabled=false"),
        ("full_ba_backend", "gtsam", "slam.optimisation.solver=gtsam"),
        ("distance_high", 90, "DISTANCE_HIGH in prgbd/plugins/slam/orb_gtsam/features/matching.py"),
    ],
)
def test_a_former_name_answers_with_the_present_one(name, value, now) -> None:
    with pytest.raises(ConfigError, match=rf"^slam\.{name} is .*{now}"):
        prgbd.make_slam("orb_gtsam", **{name: value})


def test_former_names_lead_to_what_is_there() -> None:
    folder = Path(str(orb_gtsam.__file__)).parent
    for now in FORMER_OPTIONS.values():
        if ":" in now:
            file, name = now.split(":")
            assert (folder / file).is_file()
            assert hasattr(import_module(f"{orb_gtsam.__name__}.{file[:-3].replace('/', '.')}"), name), now
        else:
            group, name = now.split(".")
            assert hasattr(getattr(Settings(), group), name), now


def test_solver_is_short_for_that_of_the_optimisation() -> None:
    for given in ({"full_ba_keyframes": 50}, OptimisationOptions(full_ba_keyframes=50)):
        settings = OrbGtsamSLAM(solver="gtsam", optimisation=given).settings
        assert settings.optimisation == OptimisationOptions(solver="gtsam", full_ba_keyframes=50)
    with pytest.raises(ConfigError, match=r"slam\.optimisation\.solver is 'ceres'"):
        OrbGtsamSLAM(solver="ceres")


def test_options_are_read_without_loading_the_system() -> None:
    heavy = "{'numba', 'gtsam', 'torch', 'cv2'}"
    code = f"import sys, prgbd.plugins.slam.orb_gtsam.settings; raise SystemExit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_number_of_features_follows_the_image() -> None:
    options = FeatureOptions()
    assert options.count_in(640, 480) == 1000
    assert options.count_in(1241, 376) == 2000
    assert 400 <= options.count_in(384, 256) < 1000
    assert FeatureOptions(count=123).count_in(1241, 376) == 123


def test_a_first_frame_needs_half_of_the_features() -> None:
    assert keypoints_to_start(1000, 640, 480) == 500
    assert keypoints_to_start(2000, 1241, 376) == 500
    assert keypoints_to_start(600, 384, 256) < 200


def test_reset_refuses_what_cannot_work() -> None:
    system, camera = OrbGtsamSLAM(), PinholeCamera.from_fov(320, 240, 60.0)
    with pytest.raises(ConfigError, match="radar"):
        system.reset(camera, "radar", baseline=0.1)
    for baseline in (None, 0.0, -1.0, float("nan")):
        with pytest.raises(ConfigError, match="baseline"):
            system.reset(camera, "rgbd", baseline=baseline)
    with pytest.raises(ConfigError, match="frame rate"):
        system.reset(camera, "mono", fps=0.0)


def test_keyframes_leave_refuted_matches_out_where_a_sensor_measures_depth() -> None:
    taken = {mode: KeyframeOptions().take_outliers(mode) for mode in ("mono", "pseudo_rgbd", "stereo", "rgbd")}
    assert taken == {"mono": True, "pseudo_rgbd": True, "stereo": False, "rgbd": False}
    assert KeyframeOptions(outliers=True).take_outliers("rgbd")
    assert not KeyframeOptions(outliers=False).take_outliers("mono")
