"""The focal length by which pairs of images fit best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prgbd.core.types import PinholeCamera
from prgbd.plugins.data.focal_length import Pair, fit_focal_length

CAMERA = PinholeCamera(640, 480, 500, 510, 318, 242)


def pairs(degrees: float, number: int = 3) -> list[Pair]:
    """Views of random points before and after a turn and a step, with noise and some wrong matches."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(number):
        points = CAMERA.backproject(rng.uniform((60, 40), (580, 440), (150, 2)), rng.uniform(3, 12, 150))
        turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.4, 0.9, 0.1])).as_matrix()
        moved = points @ turn.T + rng.normal(0, 0.2, 3)
        first, second = (CAMERA.project(p) + rng.normal(0, 0.05, (150, 2)) for p in (points, moved))
        second[:8] += rng.uniform(-20, 20, (8, 2))
        found.append((first, second))
    return found


@pytest.mark.parametrize("given", [0.8, 1.0, 1.16])
def test_the_true_focal_length_is_found_whatever_was_given(given: float) -> None:
    fit = fit_focal_length(pairs(10.0), replace(CAMERA, fx=given * CAMERA.fx, fy=given * CAMERA.fy))
    assert fit.factor * given == pytest.approx(1, abs=0.04)
    if given == 1:
        assert fit.gain < 5
    else:
        assert fit.gain > 50
        assert fit.agreement > 0.9


def test_a_camera_that_does_not_turn_says_nothing() -> None:
    assert fit_focal_length(pairs(0.0), CAMERA) is None
    assert fit_focal_length([], CAMERA) is None
