"""ORB features: equal to OpenCV's where they should be, and better spread."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.features import feature_kernels as kernels
from prgbd.plugins.slam.orb_gtsam.features.extraction import EDGE, OrbExtractor
from prgbd.plugins.slam.orb_gtsam.settings import FeatureOptions
from tests.plugins.slam.orb_gtsam.walls import CAMERA, pose, view


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    noisy = view(0, pose(0.3, 0.1, 0.2)).image.astype(np.int64)
    noisy += np.random.default_rng(0).integers(-12, 13, noisy.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def gray(image) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def extractor(**options) -> OrbExtractor:
    return OrbExtractor(FeatureOptions(**options), CAMERA.width, CAMERA.height)


def test_fast_scores_equal_opencv(gray) -> None:
    scores = np.zeros_like(gray)
    kernels.fast_scores(gray, 7, 3, scores)
    reference = np.zeros(gray.shape, int)
    for threshold in range(7, 130):
        for keypoint in cv2.FastFeatureDetector.create(threshold, False).detect(gray):
            reference[int(keypoint.pt[1]), int(keypoint.pt[0])] = threshold + 1
    inside = np.s_[3:-3, 3:-3]
    compared = reference[inside] < 129
    assert (reference[inside] > 0).sum() > 1000
    np.testing.assert_array_equal(scores[inside][compared], reference[inside][compared])


def test_cells_with_strong_corners_keep_only_those(gray) -> None:
    scores = np.zeros_like(gray)
    kernels.fast_scores(gray, 7, EDGE, scores)
    xy, score = np.empty((20000, 2), np.int32), np.empty(20000, np.int32)
    count = kernels.corners(scores, 20, 30, EDGE, xy, score)
    cells = (xy[:count] - EDGE) // 30
    for cell in np.unique(cells, axis=0):
        here = score[:count][(cells == cell).all(axis=1)]
        assert (here > 20).all() or (here <= 20).all()


def test_orientation_equals_opencv(gray) -> None:
    reference = cv2.ORB.create(500, nlevels=1).detect(gray)
    xy = np.array([k.pt for k in reference]).astype(np.int32)
    angles = kernels.orientations(gray, xy, np.arange(len(xy)))
    difference = (angles - np.array([k.angle for k in reference]) + 180) % 360 - 180
    assert len(xy) > 100
    assert np.abs(difference).max() < 0.01


def test_features_cover_more_of_the_image_than_opencv(image, gray) -> None:
    # A bright texture in one half draws all of plain ORB's keypoints.
    image, gray = image.copy(), gray.copy()
    image[:, 160:] = image[:, 160:] // 4 + 90
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)

    def covered(uv) -> int:
        return len(np.unique(np.asarray(uv, int) // 30, axis=0))

    mine = extractor(count=300).extract(image, None, 0.0)
    plain = cv2.ORB.create(300, edgeThreshold=19).detect(gray)
    assert 200 < len(mine) <= 300
    assert covered(mine.uv) > 1.3 * covered([k.pt for k in plain])


def test_features_are_sorted_by_cell_and_keep_their_columns_together(image) -> None:
    made = extractor(count=400)
    found = made.extract(image, None, 0.0)
    cell = (found.uv[:, 1] // 20).astype(int) * made.columns + (found.uv[:, 0] // 20).astype(int)
    assert (np.diff(cell) >= 0).all()
    assert found.cell_start[-1] == len(found)
    for c in (0, 17, 100):
        assert (cell[found.cell_start[c] : found.cell_start[c + 1]] == c).all()
    assert found.descriptor.shape == (len(found), 4)
    assert len(np.unique(found.octave)) == 8


def test_a_known_shift_of_the_image_is_found_at_every_level() -> None:
    shift = 6
    wide = view(0, pose(0.0), CAMERA).image
    left, right = wide[:, shift:].copy(), wide[:, :-shift].copy()
    made = OrbExtractor(FeatureOptions(count=500), left.shape[1], left.shape[0])
    a, b = made.extract(left, None, 0.0), made.extract(right, None, 0.0)
    distance = np.bitwise_count(a.descriptor[:, None] ^ b.descriptor[None]).sum(axis=2)
    best = distance.argmin(axis=1)
    good = distance[np.arange(len(a)), best] < 20
    moved = (b.uv[best] - a.uv)[good]
    assert good.sum() > 150
    assert abs(np.median(moved[:, 0]) - shift) < 0.5
    for level in range(4):
        here = moved[a.octave[good] == level]
        assert abs(np.median(here[:, 0]) - shift) < 1.0, level


def test_depth_becomes_a_column_in_the_right_image(image) -> None:
    depth = np.full(image.shape[:2], 2.0, np.float32)
    depth[:, 160:] = 0.0
    depth[:100] = np.nan
    found = extractor().extract(image, depth, 30.0)
    left = (found.uv[:, 0] < 159) & (found.uv[:, 1] > 101)
    right = (found.uv[:, 0] > 161) | (found.uv[:, 1] < 99)
    np.testing.assert_allclose(found.u_right[left], found.uv[left, 0] - 15.0, rtol=1e-6)
    assert (found.depth[left] == 2.0).all()
    assert (found.u_right[right] == -1.0).all()
    assert (found.depth[right] == 0.0).all()


@pytest.mark.parametrize("size", [(240, 320), (20, 20), (45, 60)])
def test_blank_and_tiny_images_give_no_features(size) -> None:
    blank = np.full((*size, 3), 128, np.uint8)
    found = OrbExtractor(FeatureOptions(), size[1], size[0]).extract(blank, None, 0.0)
    assert len(found) == 0
    assert found.descriptor.shape == (0, 4)


def test_extraction_is_repeatable(image) -> None:
    made = extractor()
    first, second = made.extract(image, None, 0.0), made.extract(image, None, 0.0)
    np.testing.assert_array_equal(first.uv, second.uv)
    np.testing.assert_array_equal(first.descriptor, second.descriptor)
