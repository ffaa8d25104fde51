"""Keypoints of a point are moved to the same spot of the world, and what bundle adjustment believes follows."""

import cv2
import numpy as np
import pytest

from prgbd.core.types import PinholeCamera
from prgbd.plugins.slam.orb_gtsam.camera.undistortion import Undistortion
from prgbd.plugins.slam.orb_gtsam.features.recent_images import RecentImages
from prgbd.plugins.slam.orb_gtsam.map.map_bundle import collect_bundle
from prgbd.plugins.slam.orb_gtsam.mapping.observation_alignment import ObservationAligner
from tests.plugins.slam.orb_gtsam.cloud import Cloud, at

SIZE = [(640, 480)]
# A wall 8 m ahead: a camera that moves this far to the right sees it 20 pixels to the left.
WALL, STEP, SHIFT = 8.0, 0.32, 20


class Wall:
    """Two keyframes of a wall whose second one found its corners up to a pixel beside where they are."""

    def __init__(self, *, mono: bool = False) -> None:
        rng = np.random.default_rng(0)
        self.cloud = cloud = Cloud(40, mono=mono)
        cloud.xyz[:, 2] = WALL
        noise = cv2.GaussianBlur(rng.uniform(0, 255, (480, 640)).astype(np.float32), (0, 0), 2)
        image = np.clip(127 + (noise - noise.mean()) * (40 / noise.std()), 0, 255).astype(np.uint8)
        self.pictures = [image, np.roll(image, -SHIFT, axis=1)]
        first, rows = cloud.keyframe(at(0))
        # A reference keypoint lies on a whole pixel, and the point where its ray meets the wall.
        uv = cloud.map.keyframes.uv
        uv[first] = np.rint(uv[first])
        cloud.xyz[:, :2] = (uv[first, rows] - (320, 240)) / 500 * WALL
        self.points = cloud.place(first, rows, np.arange(40))
        second, self.rows = cloud.keyframe(at(STEP), self.points)
        self.truth = uv[second, self.rows].copy()
        off = rng.uniform(-1, 1, self.truth.shape).astype(np.float32)
        uv[second, self.rows] += off
        if not mono:
            cloud.map.keyframes.u_right[second, self.rows] += off[:, 0]
        self.first, self.second = first, second

    def align(self, lens: Undistortion | None = None) -> None:
        images = RecentImages(SIZE, 2)
        for keyframe, picture in enumerate(self.pictures):
            images.add(keyframe, [picture])
        ObservationAligner(self.cloud.map, self.cloud.camera, images, lens).align(self.second)

    @property
    def found(self) -> np.ndarray:
        return self.cloud.map.keyframes.uv[self.second, self.rows]

    def inverse_variances(self) -> np.ndarray:
        """Return those of (u, v) in bundle adjustment, (2, 40)."""
        keyframes = np.array([self.first, self.second])
        fixed = np.zeros(2, np.bool_)
        bundle = collect_bundle(self.cloud.map, self.cloud.camera, keyframes, fixed, self.points)
        out = np.full((2, 40), np.nan)
        out[bundle.problem.pose_row, bundle.problem.point_row] = bundle.problem.inv_sigma2[:, 0]
        return out


@pytest.mark.parametrize("mono", [True, False])
def test_keypoints_move_to_what_the_first_one_shows(mono: bool) -> None:
    wall = Wall(mono=mono)
    disparity = wall.found[:, 0] - wall.cloud.map.keyframes.u_right[wall.second, wall.rows]
    wall.align()
    np.testing.assert_allclose(wall.found, wall.truth, atol=0.02)
    if not mono:
        after = wall.found[:, 0] - wall.cloud.map.keyframes.u_right[wall.second, wall.rows]
        np.testing.assert_allclose(after, disparity, atol=1e-4)


def test_bundle_adjustment_believes_what_agrees_and_hardly_what_does_not() -> None:
    wall = Wall()
    before = wall.inverse_variances()
    left = wall.truth[:, 0] < 300
    wall.pictures[1][:, :300] = 255 - wall.pictures[1][:, :300]
    wall.align()
    after = wall.inverse_variances()
    clear = np.abs(wall.truth[:, 0] - 300) > 8
    assert (after[:, ~left & clear] > 4 * before[:, ~left & clear]).all()
    assert (after[1, left & clear] < 0.1 * before[1, left & clear]).all()
    np.testing.assert_array_equal(after[0, left & clear], before[0, left & clear])


def test_a_keypoint_that_takes_another_point_is_an_ordinary_one_again() -> None:
    wall = Wall()
    before = wall.inverse_variances()
    wall.align()
    kf, row = wall.cloud.map.keyframes, wall.rows[:1]
    wall.cloud.map.forget(np.array([wall.second]), row)
    wall.points[:1] = wall.cloud.map.add_points(wall.second, row, wall.cloud.xyz[:1])
    assert kf.point[wall.second, row[0]] == wall.points[0]
    assert wall.inverse_variances()[1, 0] == before[1, 0]


def test_what_was_aligned_stays_where_it_is() -> None:
    wall = Wall()
    wall.align()
    once = wall.found.copy()
    wall.align()
    np.testing.assert_array_equal(wall.found, once)


def test_keyframes_whose_images_are_gone_are_left_alone() -> None:
    wall = Wall()
    before = wall.found.copy()
    images = RecentImages(SIZE, 1)
    images.add(wall.second, [wall.pictures[1]])
    ObservationAligner(wall.cloud.map, wall.cloud.camera, images).align(wall.second)
    np.testing.assert_array_equal(wall.found, before)


def test_a_lens_is_undone_and_done_again() -> None:
    camera = PinholeCamera(640, 480, 500.0, 500.0, 320.0, 240.0, (0.2, -0.5, 0.001, -0.002, 0.6))
    lens = Undistortion(camera)
    uv = np.random.default_rng(0).uniform((40, 40), (600, 440), (50, 2))
    np.testing.assert_allclose(lens(lens.back(uv).astype(np.float32))[0], uv, atol=1e-2)
    assert np.abs(lens.back(uv) - uv).max() > 1
