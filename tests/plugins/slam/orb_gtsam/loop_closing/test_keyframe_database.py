"""The index finds what looks alike, forgets what is removed, and repeats itself."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.loop_closing.keyframe_database import KeyframeDatabase
from tests.plugins.slam.orb_gtsam.appearance import descriptors, seen_again, walk


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    return walk(np.random.default_rng(0), 40)


@pytest.fixture(scope="module")
def index(images) -> KeyframeDatabase:
    return filled(images)


def filled(images: list[np.ndarray], **options) -> KeyframeDatabase:
    index = KeyframeDatabase(**options)
    for k, image in enumerate(images):
        index.add(3 * k, image)
    return index


def test_each_image_is_found_with_its_neighbours_next(index, images) -> None:
    rng, covisibility = np.random.default_rng(1), []
    for k in range(2, 38):
        ids, scores = index.query(seen_again(rng, images[k], 8))
        assert ids[0] == 3 * k
        covisibility.append(np.abs(ids[1:3] - 3 * k).max() <= 9)
        assert (np.diff(scores) <= 0).all()
        assert scores[-1] > 0
        assert scores[0] <= 1
    assert np.mean(covisibility) > 0.9


def test_a_place_never_seen_scores_below_any_that_was(index, images) -> None:
    rng = np.random.default_rng(2)
    strange = max(index.query(descriptors(rng, 300))[1][0] for _ in range(10))
    known = min(index.query(seen_again(rng, image, 15))[1][0] for image in images)
    assert known > 1.5 * strange


def test_excluded_and_further_places_are_left_out(index, images) -> None:
    ids, _ = index.query(images[20], exclude=[60, 57, 999])
    assert not {60, 57} & set(ids.tolist())
    assert ids[0] == 63
    few, scores = index.query(images[20], count=4)
    assert (len(few), len(scores)) == (4, 4)
    assert few[0] == 60


def test_the_score_of_two_keyframes_is_that_of_a_query(index, images) -> None:
    ids, scores = index.query(images[10])
    for k, score in zip(ids[:8].tolist(), scores[:8].tolist(), strict=True):
        assert index.score(30, k) == pytest.approx(score, rel=1e-5)
    assert index.score(30, 30) == pytest.approx(1.0, rel=1e-5)
    assert index.score(30, 33) == index.score(33, 30)
    with pytest.raises(KeyError):
        index.score(30, 31)


def test_removed_keyframes_are_not_found_and_their_room_is_used_again(images) -> None:
    index = filled(images)
    for k in (30, 33, 30):
        index.remove(k)
    assert len(index) == len(images) - 2
    assert 30 not in index
    assert not {30, 33} & set(index.query(images[10])[0].tolist())
    index.add(500, images[10])
    index.add(501, images[11])
    assert index.query(images[10])[0][0] == 500
    assert index.query(images[11])[0][0] == 501
    assert len(index) == len(images)
    index.add(500, images[30])
    assert len(index) == len(images)
    assert set(index.query(images[30])[0][:2]) == {90, 500}


def test_removed_keyframes_stay_away_when_the_vocabulary_is_learned_anew(images) -> None:
    index = filled(images[:6])
    index.remove(3)
    before = index.vocabulary
    for k in range(6, 20):
        index.add(3 * k, images[k])
    assert index.vocabulary is not before
    assert 3 not in index.query(images[1])[0]
    assert len(index) == 19


def test_the_vocabulary_stays_once_it_has_seen_enough(images) -> None:
    index = filled(images, learn_until=8)
    fixed = filled(images[:8], learn_until=8).vocabulary
    np.testing.assert_array_equal(index.vocabulary.centre, fixed.centre)
    rng = np.random.default_rng(3)
    hits = [index.query(seen_again(rng, image, 8))[0][0] == 3 * k for k, image in enumerate(images)]
    assert np.mean(hits) > 0.95


def test_equal_input_gives_equal_answers(images) -> None:
    a, b = (filled(images, sample=3000) for _ in range(2))
    for image in images[::5]:
        for found, again in zip(a.query(image), b.query(image), strict=True):
            np.testing.assert_array_equal(found, again)


def test_a_stored_index_answers_as_before(index, images) -> None:
    again = pickle.loads(pickle.dumps(index))
    for found, expected in zip(again.query(images[5]), index.query(images[5]), strict=True):
        np.testing.assert_array_equal(found, expected)
    again.add(1000, images[5])
    assert 1000 in again
    assert 1000 not in index


def test_an_empty_index_and_empty_images_find_nothing(images) -> None:
    index = KeyframeDatabase()
    nothing = np.zeros((0, 4), np.uint64)
    assert len(index.query(images[0])[0]) == 0
    index.add(0, nothing)
    index.add(1, images[1])
    index.add(2, nothing)
    assert len(index) == 3
    assert index.query(images[1])[0].tolist() == [1]
    assert len(index.query(nothing)[0]) == 0
    assert index.score(0, 1) == 0.0
