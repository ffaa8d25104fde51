"""Matching by window, by descriptor and along epipolar lines."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.features.epipolar_matching import match_along_epipolar_lines
from prgbd.plugins.slam.orb_gtsam.features.extraction import GRID_CELL, Features
from prgbd.plugins.slam.orb_gtsam.features.feature_kernels import cell_order
from prgbd.plugins.slam.orb_gtsam.features.matching import (
    hamming,
    match_by_descriptor,
    match_by_projection,
)

COLUMNS, ROWS = 16, 12
LEVELS = 8


def flipped(descriptors: np.ndarray, bits: int, rng: np.random.Generator) -> np.ndarray:
    """Return descriptors with ``bits`` different bits."""
    out = descriptors.copy()
    for row in out:
        for bit in rng.choice(256, bits, replace=False):
            row[bit // 64] ^= np.uint64(1) << np.uint64(bit % 64)
    return out


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.fixture
def frame(rng) -> Features:
    n = 300
    uv = np.column_stack([rng.uniform(0, 320, n), rng.uniform(0, 240, n)]).astype(np.float32)
    order, start = cell_order(uv, COLUMNS, ROWS, GRID_CELL)
    uv = np.ascontiguousarray(uv[order])
    return Features(
        uv,
        rng.integers(0, LEVELS, n).astype(np.int32),
        np.full(n, 30.0, np.float32),
        rng.integers(0, 2**63, (n, 4), dtype=np.int64).astype(np.uint64),
        np.zeros(n, np.float32),
        np.full(n, -1, np.float32),
        np.zeros((n, 3), np.uint8),
        start,
    )


def search(frame: Features, uvr: np.ndarray, descriptors: np.ndarray, **options) -> np.ndarray:
    n = len(uvr)
    levels = options.pop("levels", (np.zeros(n, np.int64), np.full(n, LEVELS, np.int64)))
    radius = options.pop("radius", np.full(n, 10.0))
    return match_by_projection(uvr, radius, levels, descriptors, frame, COLUMNS, limit=50, **options)


def beside(frame: Features, offset: tuple[float, float] = (3.0, -4.0)) -> np.ndarray:
    uvr = np.full((len(frame), 3), -1.0)
    uvr[:, :2] = frame.uv + np.array(offset, np.float32)
    return uvr


def test_hamming_counts_different_bits(rng) -> None:
    a, b = rng.integers(0, 2**63, (2, 50, 4), dtype=np.int64).astype(np.uint64)
    b[0] = a[0]
    b[1] = ~a[1]
    assert [hamming(x, y) for x, y in zip(a, b, strict=True)] == np.bitwise_count(a ^ b).sum(axis=1).tolist()


def test_projection_finds_each_point_near_its_prediction(frame, rng) -> None:
    found = search(frame, beside(frame), flipped(frame.descriptor, 20, rng))
    np.testing.assert_array_equal(found, np.arange(len(frame)))


def test_projection_keeps_to_window_level_and_limit(frame, rng) -> None:
    everything = np.arange(len(frame))
    assert (search(frame, beside(frame, (11.0, 0.0)), frame.descriptor) != everything).all()
    assert (search(frame, beside(frame), flipped(frame.descriptor, 51, rng)) == -1).all()
    octave = frame.octave.astype(np.int64)
    too_fine = search(frame, beside(frame), frame.descriptor, levels=(octave - 2, octave - 1))
    assert (too_fine == -1).all()
    taken = np.arange(len(frame)) % 2 == 0
    found = search(frame, beside(frame), frame.descriptor, taken=taken)
    assert (found[taken] == -1).all()
    np.testing.assert_array_equal(found[~taken], everything[~taken])


def test_projection_compares_the_right_column(frame) -> None:
    frame.u_right[:] = frame.uv[:, 0] - 5.0
    uvr = beside(frame, (0.0, 0.0))
    uvr[:, 2] = frame.u_right + np.where(np.arange(len(frame)) < 100, 9.0, 11.0)
    uvr = np.maximum(uvr, 0.0)
    usable = (frame.u_right >= 0) & (np.arange(len(frame)) >= 0)
    found = search(frame, uvr, frame.descriptor)
    first = np.flatnonzero(usable & (np.arange(len(frame)) < 100))
    rest = np.flatnonzero(usable & (np.arange(len(frame)) >= 100))
    np.testing.assert_array_equal(found[first], first)
    assert (found[rest] == -1).all()


def test_projection_survives_points_far_outside_the_image(frame) -> None:
    uvr = np.array([[-500.0, 50, -1], [50, -500, -1], [9e9, 50, -1], [50, 9e9, -1], [np.nan, 1, -1], [np.inf, 1, -1]])
    assert (search(frame, uvr, frame.descriptor[:6]) == -1).all()


def test_a_keypoint_goes_to_its_nearest_point_only(frame, rng) -> None:
    uvr = np.repeat(beside(frame)[:1], 3, axis=0)
    descriptors = np.concatenate([flipped(frame.descriptor[:1], bits, rng) for bits in (30, 10, 20)])
    np.testing.assert_array_equal(search(frame, uvr, descriptors), [-1, 0, -1])


def test_ratio_test_drops_ambiguous_matches(frame, rng) -> None:
    frame.uv[1], frame.octave[1] = frame.uv[0], frame.octave[0]
    frame.descriptor[1] = flipped(frame.descriptor[:1], 4, rng)[0]
    query = flipped(frame.descriptor[:1], 20, rng)
    assert search(frame, beside(frame)[:1], query, ratio=0.8)[0] == -1
    assert search(frame, beside(frame)[:1], query, ratio=1.0)[0] in (0, 1)


def test_matches_of_another_rotation_are_dropped(frame) -> None:
    angles = np.full(len(frame), 75.0, np.float32)
    angles[:20] = 200.0
    found = search(frame, beside(frame), frame.descriptor, angles=angles)
    assert (found[:20] == -1).all()
    assert (found[20:] >= 0).all()


def test_descriptors_alone_find_their_like(frame, rng) -> None:
    queries = flipped(frame.descriptor, 25, rng)
    queries[:10] = rng.integers(0, 2**63, (10, 4), dtype=np.int64).astype(np.uint64)
    found = match_by_descriptor(queries, frame.angle, frame, limit=50, ratio=0.7)
    assert (found[:10] == -1).all()
    np.testing.assert_array_equal(found[10:], np.arange(10, len(frame)))


def test_epipolar_search_finds_partners_within_the_segment(frame, rng) -> None:
    """A pure shift to the side: the partner lies on the same row, shifted by 4 to 30 pixels."""
    disparity = rng.uniform(4, 30, len(frame)).astype(np.float32)
    first = frame.uv + np.column_stack([disparity, np.zeros_like(disparity)])
    F = np.array([[0.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    ends = np.column_stack([first, first - (20.0, 0.0)]).astype(np.float64)
    found = match_along_epipolar_lines(
        np.arange(len(frame)),
        first,
        flipped(frame.descriptor, 15, rng),
        frame.angle,
        frame.uv,
        frame.octave,
        frame.descriptor,
        frame.angle,
        frame.cell_start,
        np.zeros(len(frame), np.bool_),
        COLUMNS,
        GRID_CELL,
        F,
        ends,
        np.full(2, 1e9),
        1.2 ** np.arange(LEVELS),
        50,
        0.6,
    )
    covisibility = disparity < 19
    np.testing.assert_array_equal(found[covisibility], np.flatnonzero(covisibility))
    wrong = (found >= 0) & (found != np.arange(len(frame)))
    assert not wrong.any()
