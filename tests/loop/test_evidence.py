"""What SLAM says of a network without labels, on a world whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prgbd.core.types import Trajectory
from prgbd.loop.evidence import evidence, photometric_errors
from tests.training.scenes import WallSequence, true_slam_result


class Known:
    """A sensor with a depth of its own making."""

    def __init__(self, sequence, depth=lambda index, true: true):
        from tests.training.test_refinement import TiltNet

        self.sequence, self.estimator, self._depth = sequence, TiltNet(), depth

    def __len__(self):
        return len(self.sequence)

    def depth(self, index):
        return self._depth(index, self.sequence.depth(index)).astype(np.float32)


@pytest.fixture(scope="module")
def world():
    sequence = WallSequence(24, step=0.25)
    return sequence, true_slam_result(sequence)


def test_photometric_error_is_lowest_at_the_truth_and_ignores_a_common_scale(world):
    sequence, result = world
    true = photometric_errors(result, Known(sequence), 2)
    wrong = photometric_errors(result, Known(sequence, lambda i, d: 5 * (d / 5) ** 0.3), 2)
    assert set(true) == set(wrong)
    assert not set(map(int, true)) & set(result.keyframes.frame_index.tolist())
    assert np.mean(list(wrong.values())) > 1.15 * np.mean(list(true.values()))
    wTc = result.trajectory.wTc.copy()
    wTc[:, :3, 3] *= 3
    scaled = replace(result, trajectory=replace(result.trajectory, wTc=wTc))
    both = photometric_errors(scaled, Known(sequence, lambda i, d: 3 * d), 2)
    np.testing.assert_allclose(list(both.values()), list(true.values()), rtol=1e-3)


def test_frames_without_poses_are_left_out(world):
    sequence, result = world
    short = result.trajectory
    short = Trajectory(short.frame_index[:10], short.timestamp[:10], short.wTc[:10])
    found = evidence(replace(result, trajectory=short), Known(sequence))
    assert found["tracked"] == pytest.approx(10 / 24)
    assert max(map(int, found["photometric"])) < 9
    assert found["maps"] == 1


def test_images_are_warped_with_the_camera_that_the_poses_belong_to(world):
    """Self-calibration may have refined it: a sideways motion in metres belongs to one focal length."""
    sequence, result = world
    true = photometric_errors(result, Known(sequence), 2)
    camera = replace(result.camera, fx=1.2 * result.camera.fx, fy=1.2 * result.camera.fy)
    other = photometric_errors(replace(result, camera=camera), Known(sequence), 2)
    assert np.mean(list(other.values())) > 1.1 * np.mean(list(true.values()))
