"""Dead reckoning: motion that goes on as it did."""

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, inverse
from prgbd.plugins.slam.orb_gtsam.tracking.motion_model import MotionModel

TWIST = np.array([0.0, 0.02, 0.0, 0.01, 0.0, -0.3])


def camera(frame):
    """A car in a bend."""
    return exp_se3(TWIST * frame)


def test_a_steady_bend_is_carried_on_over_missing_frames():
    reckoning = MotionModel()
    for frame in (0, 1, 2, 4, 5, 9):
        reckoning.add(frame, camera(frame))
    np.testing.assert_allclose(reckoning.after(30) @ camera(9), camera(39), atol=1e-9)
    np.testing.assert_allclose(reckoning.after(0), np.eye(4))


def test_only_the_last_frames_count():
    reckoning = MotionModel()
    for frame in range(20):
        reckoning.add(frame, camera(max(frame - 10, 0)))
    moved = reckoning.after(5) @ camera(9)
    np.testing.assert_allclose(moved, camera(14), atol=1e-9)


@pytest.mark.parametrize("known", [0, 1])
def test_without_motion_it_stays(known):
    reckoning = MotionModel()
    for frame in range(known):
        reckoning.add(frame, camera(frame))
    np.testing.assert_allclose(reckoning.after(10), np.eye(4))


def test_it_forgets():
    reckoning = MotionModel()
    for frame in range(5):
        reckoning.add(frame, inverse(camera(frame)))
    reckoning.clear()
    np.testing.assert_allclose(reckoning.after(10), np.eye(4))
