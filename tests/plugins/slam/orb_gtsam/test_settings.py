"""Options of ``orb_gtsam``."""

from __future__ import annotations

import pytest

from prgbd.core.errors import ConfigError
from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.settings import Settings


def test_an_unknown_option_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"no option 'feature'.*'features'"):
        OrbGtsamSLAM(feature=500)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("features", 0),
        ("features", "many"),
        ("levels", 0),
        ("levels", 2.5),
        ("scale_factor", 1.0),
        ("fast_threshold", 5),
        ("local_ba", "yes"),
        ("local_ba_iterations", [5]),
        ("redundancy", float("nan")),
        ("keyframe_ratio", -0.5),
        ("full_ba_backend", "ceres"),
        ("recovery_keyframes", None),
    ],
)
def test_a_bad_value_is_named(name, value) -> None:
    with pytest.raises(ConfigError, match=name):
        OrbGtsamSLAM(**{name: value})


def test_values_from_yaml_take_the_right_type() -> None:
    settings = Settings.from_options({"close_depth": 35, "local_ba_iterations": [3, 6], "features": 800, "levels": 4.0})
    assert settings.close_depth == 35.0
    assert settings.local_ba_iterations == (3, 6)
    assert settings.levels == 4
    assert isinstance(settings.levels, int)


def test_the_number_of_features_follows_the_image() -> None:
    settings = Settings()
    assert settings.feature_count(640, 480) == 1000
    assert settings.feature_count(1241, 376) == 2000
    assert 400 <= settings.feature_count(384, 256) < 1000
    assert Settings(features=123).feature_count(1241, 376) == 123
    assert settings.keypoints_to_start(640, 480) == 500
    assert settings.keypoints_to_start(1241, 376) == 500
    assert settings.keypoints_to_start(384, 256) < 200


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
    taken = {mode: Settings().takes_outliers(mode) for mode in ("mono", "pseudo_rgbd", "stereo", "rgbd")}
    assert taken == {"mono": True, "pseudo_rgbd": True, "stereo": False, "rgbd": False}
    assert Settings(keyframe_outliers=True).takes_outliers("rgbd")
    assert not Settings(keyframe_outliers=False).takes_outliers("mono")


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_a_share_of_points_is_a_share(share: float) -> None:
    with pytest.raises(ConfigError, match="keyframe_held"):
        Settings(keyframe_held=share)
