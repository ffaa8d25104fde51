"""Scale and shift of inverse depth."""

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.geometry.affine_fit import Affine, fit_affine


@pytest.fixture
def points():
    """Inverse depths with errors of 5 %, of which a fifth is quite wrong."""
    rng = np.random.default_rng(0)
    y = rng.uniform(0.05, 0.5, 200)
    x = (y * (1 + 0.05 * rng.standard_normal(200)) - 0.08) / 0.3
    x[:40] = rng.uniform(-0.2, 1.5, 40)
    return x, y


def test_outliers_do_not_count(points) -> None:
    x, y = points
    found = fit_affine(x, y, 0.05 * y + 0.01)
    assert (found.scale, found.shift) == pytest.approx((0.3, 0.08), rel=0.03)
    plain = np.polyfit(x, y, 1)
    assert abs(plain[0] - 0.3) > 5 * abs(found.scale - 0.3)


def test_the_unit_of_the_errors_does_not_matter(points) -> None:
    x, y = points
    one, other = (fit_affine(1e3 * x, 7.0 * y, unit * (0.05 * y + 0.01)) for unit in (7.0, 70.0))
    assert one.scale == pytest.approx(0.3 * 7e-3, rel=0.03)
    assert other.scale == pytest.approx(one.scale, rel=0.02)


def test_a_plane_keeps_to_what_was_known_before() -> None:
    y = np.full(50, 0.2) + 1e-6 * np.arange(50)
    x = np.full(50, 0.5) + 1e-6 * np.arange(50)[::-1]
    found = fit_affine(x, y, 0.15 * y, Affine(0.3, 0.05), Affine(0.03, 0.02))
    assert found(x) == pytest.approx(y, rel=0.02), "the mean follows the points"
    assert found.scale == pytest.approx(0.3, abs=0.03), "the slope does not"
