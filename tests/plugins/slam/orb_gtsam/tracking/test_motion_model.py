"""The motion model: motion that goes on as it did."""

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, inverse
from prgbd.plugins.slam.orb_gtsam.tracking.motion_model import MotionModel

TWIST = np.array([0.0, 0.02, 0.0, 0.01, 0.0, -0.3])


def camera(frame):
    """A car in a bend."""
    return exp_se3(TWIST * frame)


def test_a_steady_bend_is_carried_on_over_missing_frames():
    model = MotionModel()
    for frame in (0, 1, 2, 4, 5, 9):
        model.add(frame, camera(frame))
    np.testing.assert_allclose(model.after(30) @ camera(9), camera(39), atol=1e-9)
    np.testing.assert_allclose(model.after(0), np.eye(4))


def test_only_the_last_frames_count():
    model = MotionModel()
    for frame in range(20):
        model.add(frame, camera(max(frame - 10, 0)))
    moved = model.after(5) @ camera(9)
    np.testing.assert_allclose(moved, camera(14), atol=1e-9)


@pytest.mark.parametrize("known", [0, 1])
def test_without_motion_it_stays(known):
    model = MotionModel()
    for frame in range(known):
        model.add(frame, camera(frame))
    np.testing.assert_allclose(model.after(10), np.eye(4))


def test_it_forgets():
    model = MotionModel()
    for frame in range(5):
        model.add(frame, inverse(camera(frame)))
    model.clear()
    np.testing.assert_allclose(model.after(10), np.eye(4))
