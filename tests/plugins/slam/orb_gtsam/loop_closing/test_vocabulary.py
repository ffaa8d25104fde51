"""The vocabulary finds clusters that are there, and is the same each time."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.loop_closing.vocabulary import Vocabulary
from tests.plugins.slam.orb_gtsam.appearance import descriptors, seen_again


def clusters(count: int, members: int, flips: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    centres = descriptors(rng, count)
    order = rng.permutation(np.repeat(np.arange(count), members))
    return seen_again(rng, centres[order], flips), order


def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.unpackbits((a ^ b).view(np.uint8), axis=-1).sum(axis=-1)


def test_well_apart_clusters_become_words() -> None:
    samples, truth = clusters(count=64, members=30, flips=20)
    vocabulary = Vocabulary.learn(samples, branching=8, depth=2, smallest=40)
    words = vocabulary.words(samples)
    # Few clusters are cut in two at the upper level, and most have a word of their own.
    assert np.mean([len(np.unique(words[truth == c])) == 1 for c in range(64)]) > 0.8
    assert np.mean([len(np.unique(truth[words == w])) == 1 for w in np.unique(words)]) > 0.6
    assert len(np.unique(words)) > 50


def test_the_centre_of_a_cluster_is_the_majority_of_its_members() -> None:
    rng = np.random.default_rng(1)
    centres = descriptors(rng, 4)
    samples = seen_again(rng, np.repeat(centres, 101, axis=0), 30)
    vocabulary = Vocabulary.learn(samples, branching=4, depth=1)
    found = vocabulary.centre[1:]
    nearest = np.array([[distance(c, f) for f in found] for c in centres])
    assert len(vocabulary) == 4
    assert sorted(nearest.argmin(axis=1)) == [0, 1, 2, 3]
    assert nearest.min(axis=1).max() == 0


def test_the_same_thing_seen_again_gets_the_same_word() -> None:
    rng = np.random.default_rng(2)
    samples = descriptors(rng, 5000)
    vocabulary = Vocabulary.learn(samples)
    words = vocabulary.words(samples)
    assert 500 < len(vocabulary) <= 5000
    assert words.min() >= 0
    assert words.max() < len(vocabulary)
    same = vocabulary.words(seen_again(rng, samples, 10)) == words
    other = vocabulary.words(rng.permutation(samples)) == words
    assert same.mean() > 0.4
    assert other.mean() < 0.01


def test_equal_input_gives_an_equal_vocabulary() -> None:
    samples, _ = clusters(count=300, members=10, flips=25)
    first, second = (Vocabulary.learn(samples, seed=3) for _ in range(2))
    other = Vocabulary.learn(samples, seed=4)
    np.testing.assert_array_equal(first.centre, second.centre)
    np.testing.assert_array_equal(first.first_child, second.first_child)
    assert first.centre.shape != other.centre.shape or (first.centre != other.centre).any()


@pytest.mark.parametrize("count", [1, 7])
def test_a_few_or_equal_descriptors_make_a_vocabulary_too(count: int) -> None:
    samples = np.repeat(descriptors(np.random.default_rng(0), 1), count, axis=0)
    vocabulary = Vocabulary.learn(samples)
    assert len(vocabulary) == 1
    assert (vocabulary.words(samples) == 0).all()
