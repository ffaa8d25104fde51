"""The map against a plain dictionary that is kept beside it."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.features.extraction import Features
from prgbd.plugins.slam.orb_gtsam.geometry.lie import exp_se3, inverse
from prgbd.plugins.slam.orb_gtsam.map.covisibility import CovisibilityGraph
from prgbd.plugins.slam.orb_gtsam.map.map import Map

CAPACITY, CELLS = 40, 6


def features(n: int, rng: np.random.Generator) -> Features:
    return Features(
        rng.uniform(0, 100, (n, 2)).astype(np.float32),
        rng.integers(0, 8, n).astype(np.int32),
        rng.uniform(0, 360, n).astype(np.float32),
        rng.integers(0, 2**63, (n, 4), dtype=np.int64).astype(np.uint64),
        np.where(rng.random(n) < 0.5, 2.0, 0.0).astype(np.float32),
        np.where(rng.random(n) < 0.5, 5.0, -1.0).astype(np.float32),
        rng.integers(0, 256, (n, 3)).astype(np.uint8),
        np.zeros(CELLS + 1, np.int32),
    )


def add_keyframe(slam_map: Map, rng: np.random.Generator, n: int = CAPACITY) -> int:
    cTw = exp_se3(rng.normal(0, 0.1, 6))
    return slam_map.add_keyframe(slam_map.keyframes.count, 0.1, cTw, features(n, rng), np.full(n, -1, np.int64))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2)


@pytest.fixture
def slam_map() -> Map:
    return Map(CAPACITY, CELLS, 1.2 ** np.arange(8))


def observed(slam_map: Map) -> dict[int, set[tuple[int, int]]]:
    """Return the observations of every point by the lists, after checking that both directions agree."""
    alive = np.flatnonzero(~slam_map.points.bad[: slam_map.points.count])
    by_list: dict[int, set[tuple[int, int]]] = {int(p): set() for p in alive}
    for k, i, at in slam_map.observations(alive).tolist():
        by_list[int(alive[at])].add((k, i))
    by_keypoint: dict[int, set[tuple[int, int]]] = {int(p): set() for p in alive}
    for k in range(slam_map.keyframes.count):
        for i in np.flatnonzero(slam_map.keyframes.point[k] >= 0).tolist():
            by_keypoint[int(slam_map.keyframes.point[k, i])].add((k, i))
    assert by_list == by_keypoint
    return by_list


def test_random_changes_keep_both_directions_alike(slam_map, rng) -> None:
    truth: dict[int, set[tuple[int, int]]] = {}
    for _ in range(25):
        k = add_keyframe(slam_map, rng)
        free = list(range(CAPACITY))
        rng.shuffle(free)
        alive = [p for p in truth if not slam_map.points.bad[p]]
        for p in rng.permutation(alive)[:15].tolist():
            row = free.pop()
            slam_map.observe(k, np.array([row]), np.array([p]))
            truth[p].add((k, row))
        rows = np.array(free[:10])
        for p, row in zip(slam_map.add_points(k, rows, rng.normal(size=(10, 3))).tolist(), rows.tolist(), strict=True):
            truth[p] = {(k, row)}
        victims = [(p, *o) for p in truth for o in truth[p]]
        for p, at, row in [victims[j] for j in rng.choice(len(victims), 3, replace=False)]:
            slam_map.forget(np.array([at]), np.array([row]))
            truth[p].discard((at, row))
        gone = int(rng.choice(list(truth)))
        slam_map.remove_points(np.array([gone]))
        del truth[gone]
        old, new = rng.choice(list(truth), 2, replace=False).tolist()
        slam_map.merge(old, new)
        seen_by_new = {at for at, _ in truth[new]}
        truth[new] |= {o for o in truth.pop(old) if o[0] not in seen_by_new}
        assert observed(slam_map) == truth
        assert slam_map.current(np.array([old, gone, new, -1])).tolist() == [new, -1, new, -1]
    counts = slam_map.observation_counts(np.array(list(truth)), double=False)
    assert counts.tolist() == [len(o) for o in truth.values()]
    right = slam_map.keyframes.u_right
    doubled = [sum(2 if right[o] >= 0 else 1 for o in seen) for seen in truth.values()]
    assert slam_map.observation_counts(np.array(list(truth)), double=True).tolist() == doubled


def test_an_occupied_keypoint_keeps_its_point(slam_map, rng) -> None:
    k = add_keyframe(slam_map, rng)
    first, second = slam_map.add_points(k, np.array([3, 4]), np.zeros((2, 3)))
    slam_map.observe(k, np.array([3]), np.array([second]))
    assert observed(slam_map) == {int(first): {(k, 3)}, int(second): {(k, 4)}}


def test_covisible_keyframes_come_in_order_of_common_points(slam_map, rng) -> None:
    a, b, c, d = (add_keyframe(slam_map, rng) for _ in range(4))
    points = slam_map.add_points(a, np.arange(30), rng.normal(size=(30, 3)))
    slam_map.observe(b, np.arange(10), points[:10])
    slam_map.observe(c, np.arange(20), points[:20])
    slam_map.observe(d, np.arange(3), points[:3])
    graph = CovisibilityGraph(slam_map, 5)
    order, weights = graph.ranked(a, 5)
    assert (order.tolist(), weights.tolist()) == ([c, b], [20, 10])
    # Without a strong neighbour the best one counts.
    assert graph.ranked(d, 5)[0].tolist() == [a]
    assert slam_map.seen_by(np.array([b, d])).tolist() == points[:10].tolist()


def test_frames_follow_the_keyframe_that_replaced_theirs(slam_map, rng) -> None:
    a, b, c = (add_keyframe(slam_map, rng) for _ in range(3))
    points = slam_map.add_points(b, np.arange(5), rng.normal(size=(5, 3)))
    before = [slam_map.pose_of(k).copy() for k in (a, b, c)]
    slam_map.cull_keyframe(b, a)
    slam_map.cull_keyframe(c, b)
    assert slam_map.successor(c) == a
    assert slam_map.alive().tolist() == [a]
    assert (slam_map.observation_counts(points, double=False) == 0).all()
    for k in (a, b, c):
        np.testing.assert_allclose(slam_map.pose_of(k), before[k], atol=1e-12)
    moved = exp_se3(np.array([0.1, 0.2, -0.1, 1.0, 2.0, 3.0]))
    slam_map.set_pose(a, slam_map.keyframes.cTw[a] @ inverse(moved))
    np.testing.assert_allclose(slam_map.pose_of(c), before[c] @ inverse(moved), atol=1e-12)


def test_refreshed_points_have_direction_range_and_a_typical_descriptor(slam_map, rng) -> None:
    ks = [add_keyframe(slam_map, rng) for _ in range(5)]
    kf = slam_map.keyframes
    typical = kf.descriptor[ks[1], 0].copy()
    for word, k in zip(range(4), (0, 2, 3, 4), strict=True):
        kf.descriptor[ks[k], 0] = typical
        kf.descriptor[ks[k], 0, word] ^= np.uint64(0b1111)
    kf.octave[ks[0], 0] = 3
    xyz = np.array([0.5, -0.2, 4.0])
    (point,) = slam_map.add_points(ks[0], np.array([0]), xyz[None])
    for k in ks[1:]:
        slam_map.observe(k, np.array([0]), np.array([point]))
    slam_map.refresh(np.array([point]))
    rays = xyz - kf.centre[ks]
    mean = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).sum(axis=0)
    np.testing.assert_allclose(slam_map.points.normal[point], mean / np.linalg.norm(mean), atol=1e-9)
    farthest = np.linalg.norm(rays[0]) * 1.2**3
    np.testing.assert_allclose(slam_map.points.distance_range[point], [farthest / 1.2**7, farthest])
    np.testing.assert_array_equal(slam_map.points.descriptor[point], typical)
