"""The linked lists of observations, and what is computed along them, on lists written by hand."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.map import map_kernels as kernels

KEYFRAMES, CAPACITY, POINTS = 3, 4, 5


class Links:
    """Empty columns of three keyframes with four keypoints, and five points."""

    def __init__(self) -> None:
        self.point_of = np.full((KEYFRAMES, CAPACITY), -1, np.int64)
        self.following = self.point_of.copy()
        self.head = np.full(POINTS, -1, np.int64)

    @property
    def columns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.point_of, self.following, self.head

    def observe(self, k: int, rows: list[int], points: list[int]) -> None:
        kernels.observe(*self.columns, k, np.array(rows), np.array(points))

    def seen(self, point: int) -> list[tuple[int, int]]:
        """Return the observations of a point, the latest first."""
        found = kernels.observations_of(self.following, self.head, np.array([point]), CAPACITY)
        return [(k, i) for k, i, _ in found.tolist()]


@pytest.fixture
def links() -> Links:
    """Point 0 is seen by all keyframes, 1 by the first two, 2 by the last."""
    links = Links()
    links.observe(0, [0, 1], [0, 1])
    links.observe(1, [2, 3], [0, 1])
    links.observe(2, [0, 3], [0, 2])
    return links


def test_observations_are_listed_latest_first_and_by_position(links) -> None:
    assert links.seen(0) == [(2, 0), (1, 2), (0, 0)]
    found = kernels.observations_of(links.following, links.head, np.array([2, 3, 1]), CAPACITY)
    assert found.tolist() == [[2, 3, 0], [1, 3, 2], [0, 1, 2]]


def test_a_keypoint_observes_one_point(links) -> None:
    links.observe(0, [0, 2], [3, 3])
    assert links.point_of[0].tolist() == [0, 1, 3, -1]
    assert links.seen(3) == [(0, 2)]


@pytest.mark.parametrize(
    ("k", "i", "left"), [(2, 0, [(1, 2), (0, 0)]), (1, 2, [(2, 0), (0, 0)]), (0, 0, [(2, 0), (1, 2)])]
)
def test_an_observation_is_taken_out_of_any_place_of_the_list(links, k, i, left) -> None:
    kernels.forget(*links.columns, k, i)
    assert links.seen(0) == left
    assert (links.point_of[k, i], links.following[k, i]) == (-1, -1)
    kernels.forget(*links.columns, k, i)  # nothing there any more
    assert links.seen(0) == left


def test_several_observations_are_taken_out_at_once(links) -> None:
    kernels.forget_many(*links.columns, np.array([0, 1]), np.array([0, 3]))
    assert (links.seen(0), links.seen(1)) == ([(2, 0), (1, 2)], [(0, 1)])


def test_a_removed_point_frees_its_keypoints(links) -> None:
    bad = np.zeros(POINTS, np.bool_)
    kernels.remove_points(*links.columns, bad, np.array([0]))
    assert bad.tolist() == [True, False, False, False, False]
    assert links.seen(0) == []
    assert links.point_of.tolist() == [[-1, 1, -1, -1], [-1, -1, -1, 1], [-1, -1, -1, 2]]


def test_a_merged_point_gives_what_the_other_lacks(links) -> None:
    bad, replaced_by = np.zeros(POINTS, np.bool_), np.full(POINTS, -1, np.int64)
    kernels.merge_point(*links.columns, bad, replaced_by, 1, 2)
    # Keyframe 2 saw point 2; keyframes 0 and 1 see it now as well.
    assert sorted(links.seen(2)) == [(0, 1), (1, 3), (2, 3)]
    assert (bad[1], replaced_by[1]) == (True, 2)
    kernels.merge_point(*links.columns, bad, replaced_by, 0, 2)
    assert sorted(links.seen(2)) == [(0, 1), (1, 3), (2, 3)]
    assert links.point_of[2].tolist() == [-1, -1, -1, 2]


def test_observations_with_depth_count_twice_if_they_may(links) -> None:
    u_right = np.full((KEYFRAMES, CAPACITY), -1.0, np.float32)
    u_right[0, 0], u_right[2, 0] = 3.0, 0.0
    asked = np.array([0, 1, -1, 3])
    counted = [kernels.count_observations(u_right, links.following, links.head, asked, d) for d in (False, True)]
    assert [c.tolist() for c in counted] == [[3, 2, 0, 0], [5, 2, 0, 0]]


def test_common_points_are_counted_by_keyframe(links) -> None:
    found = kernels.common_points(np.array([0, 1, -1]), links.following, links.head, KEYFRAMES, CAPACITY)
    assert found.tolist() == [2, 2, 1]


def test_points_come_once_in_order_of_first_sight(links) -> None:
    assert kernels.points_seen_by(links.point_of, np.array([2, 0]), POINTS).tolist() == [0, 2, 1]


def test_direction_and_range_of_a_point(links) -> None:
    centres = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, 0]])
    octave = np.zeros((KEYFRAMES, CAPACITY), np.int32)
    octave[1, 3] = 2
    scales, xyz = 2.0 ** np.arange(4), np.zeros((POINTS, 3))
    xyz[1] = [0, 0, 1]
    reference = np.full(POINTS, 1)
    normal, span = np.zeros((POINTS, 3)), np.zeros((POINTS, 2))
    kernels.refresh_geometry(
        links.following, links.head, np.array([1, 3]), CAPACITY, centres, octave, scales, reference, xyz, normal, span
    )
    # Both rays rise by 45 degrees; the reference keyframe sees the point at sqrt(2), two levels up.
    np.testing.assert_allclose(normal[1], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(span[1], [np.sqrt(2) * 4 / 8, np.sqrt(2) * 4])
    assert not normal[3].any()
    # Without its reference keyframe the oldest in the list that is left takes over.
    kernels.forget(*links.columns, 1, 3)
    kernels.refresh_geometry(
        links.following, links.head, np.array([1]), CAPACITY, centres, octave, scales, reference, xyz, normal, span
    )
    assert reference[1] == 0
    np.testing.assert_allclose(normal[1], np.array([1, 0, 1]) / np.sqrt(2))


def test_the_descriptor_in_the_middle_is_chosen(links) -> None:
    observed = np.zeros((KEYFRAMES, CAPACITY, 4), np.uint64)
    observed[0, 0, 0], observed[1, 2, 0], observed[2, 0, 0] = 0b1, 0b11, 0b111111
    chosen = np.zeros((POINTS, 4), np.uint64)
    kernels.refresh_descriptors(links.following, links.head, np.array([0, 3]), observed, chosen)
    # Distances 0-1: 1, 1-2: 4, 0-2: 5; medians of (0, 1, 5), (0, 1, 4), (0, 4, 5). The latest of the equals wins.
    assert chosen[0].tolist() == [0b11, 0, 0, 0]
    assert not chosen[3].any()
