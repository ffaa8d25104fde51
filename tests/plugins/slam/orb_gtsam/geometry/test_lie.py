import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from prgbd.plugins.slam.orb_gtsam.geometry.lie import (
    compose_into,
    exp_se3,
    exp_so3,
    inverse,
    log_se3,
    log_so3,
    orthonormalise,
)


def hat(xi):
    x, y, z, *v = xi
    return np.array([[0, -z, y, v[0]], [z, 0, -x, v[1]], [-y, x, 0, v[2]], [0, 0, 0, 0]])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1.1e-5, 1e-3, 0.5, 2.0, 3.1])
def test_the_exponential_is_the_matrix_exponential(angle):
    xi = np.array([0.36, -0.48, 0.8, 1.0, 2.0, -0.5])
    xi[:3] *= angle
    np.testing.assert_allclose(exp_se3(xi), expm(hat(xi)), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 1e-3, 1.0, 3.0, np.pi - 1e-7])
def test_the_logarithm_inverts_the_exponential(angle):
    for axis in (np.eye(3)[0], np.eye(3)[1], np.eye(3)[2], np.array([0.36, -0.48, 0.8])):
        xi = np.concatenate([axis * angle, [1.0, 2.0, -0.5]])
        np.testing.assert_allclose(log_se3(exp_se3(xi)), xi, atol=1e-8)


def test_rotations_agree_with_scipy():
    for rotation in Rotation.random(20, random_state=0):
        np.testing.assert_allclose(exp_so3(rotation.as_rotvec()), rotation.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(log_so3(rotation.as_matrix()), rotation.as_rotvec(), atol=1e-9)
    half_turn = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(np.abs(log_so3(half_turn)), [np.pi, 0, 0], atol=1e-12)


def test_log_agrees_with_the_matrix_logarithm():
    pose = exp_se3(np.array([0.3, -1.0, 0.5, 2.0, 0.1, 1.0]))
    expected = np.real(logm(pose))
    np.testing.assert_allclose(hat(log_se3(pose)), expected, atol=1e-9)


def test_inverse_and_composition():
    a, b = exp_se3(np.array([0.1, 0.2, 0.3, 1, 2, 3.0])), exp_se3(np.array([-1, 0.2, 0.1, 3, 1, 0.0]))
    np.testing.assert_allclose(inverse(np.stack([a, b])), np.linalg.inv(np.stack([a, b])), atol=1e-12)
    out = np.eye(4)
    compose_into(a, b, out)
    np.testing.assert_allclose(out, a @ b, atol=1e-12)


def test_a_drifted_rotation_becomes_a_rotation_again():
    pose = exp_se3(np.array([0.1, 0.7, 0.3, 1, 2, 3.0]))
    drifted = pose.copy()
    drifted[:3, :3] += 1e-6 * np.random.default_rng(0).standard_normal((3, 3))
    orthonormalise(drifted)
    np.testing.assert_allclose(drifted[:3, :3] @ drifted[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(drifted, pose, atol=1e-5)
