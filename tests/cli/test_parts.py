"""Which mode of SLAM the recordings themselves suggest."""

from dataclasses import replace

import pytest

import prgbd
from prgbd.cli.parts import _mode_of_sequences

ALL = frozenset({"mono", "rgbd", "stereo"})
SMALL = {"scene": "indoor", "frames": 3, "width": 160, "height": 120}


@pytest.fixture(scope="module")
def pair():
    return prgbd.make_data("synthetic", baseline=0.2, **SMALL)


@pytest.fixture(scope="module")
def alone():
    return prgbd.make_data("synthetic", **SMALL)


def test_right_images_suggest_stereo_and_a_depth_sensor_goes_first(pair, alone):
    both = prgbd.make_data("synthetic", baseline=0.2, sensor_depth=True, **SMALL)
    assert _mode_of_sequences([pair], ALL) == "stereo"
    assert _mode_of_sequences([both], ALL) == "rgbd"
    assert _mode_of_sequences([alone], ALL) == "mono"


def test_one_recording_without_right_images_makes_all_monocular(pair, alone):
    assert _mode_of_sequences([pair, alone], ALL) == "mono"


def test_a_system_without_stereo_is_not_given_it(pair):
    assert _mode_of_sequences([pair], ALL - {"stereo"}) == "mono"


def test_right_images_that_end_early_do_not_count(pair, monkeypatch):
    whole = pair.frame
    monkeypatch.setattr(pair, "frame", lambda i: replace(whole(i), right=None) if i == len(pair) - 1 else whole(i))
    assert _mode_of_sequences([pair], ALL) == "mono"
