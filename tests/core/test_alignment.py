import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prgbd.core.alignment import fit_alignment
from prgbd.core.errors import ConfigError


@pytest.mark.parametrize("kind", ["sim3", "se3"])
def test_a_known_transform_is_found(kind):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(40, 3))
    R, t, s = Rotation.random(random_state=1).as_matrix(), np.array([1.0, -2, 3]), 2.5 if kind == "sim3" else 1.0
    found = fit_alignment(x, s * x @ R.T + t, kind)
    np.testing.assert_allclose(found.rotation, R, atol=1e-12)
    np.testing.assert_allclose(found.translation, t, atol=1e-12)
    assert found.scale == pytest.approx(s)
    np.testing.assert_allclose(found.points(x), s * x @ R.T + t, atol=1e-12)


def test_poses_stay_rigid():
    x = np.random.default_rng(0).normal(size=(5, 3))
    R = Rotation.random(random_state=1).as_matrix()
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = x
    moved = fit_alignment(x, 3 * x @ R.T, "sim3").poses(poses)
    np.testing.assert_allclose(moved[:, :3, :3], np.broadcast_to(R, (5, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(moved[:, :3, 3], 3 * x @ R.T, atol=1e-12)


def test_a_straight_path_is_aligned_without_a_warning():
    truth = np.outer(np.arange(10.0), [0.0, 0.0, 1.0])
    estimate = 0.5 * np.outer(np.arange(10.0), [1.0, 0.0, 0.0]) + 7
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fit_alignment(estimate, truth, "sim3")
        rigid = fit_alignment(2 * estimate, truth, "se3")
    np.testing.assert_allclose(found.points(estimate), truth, atol=1e-9)
    np.testing.assert_allclose(rigid.points(2 * estimate), truth, atol=1e-9)
    assert found.scale == pytest.approx(2.0)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_an_estimate_that_stands_still_keeps_its_size():
    found = fit_alignment(np.ones((4, 3)), np.random.default_rng(0).normal(size=(4, 3)))
    assert found.scale == 1.0
    np.testing.assert_array_equal(found.rotation, np.eye(3))


def test_an_unknown_alignment_is_a_config_error():
    with pytest.raises(ConfigError, match="sim3, se3, none"):
        fit_alignment(np.zeros((3, 3)), np.zeros((3, 3)), "affine")
