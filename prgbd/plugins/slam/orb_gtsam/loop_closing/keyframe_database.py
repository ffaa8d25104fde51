"""Place recognition: which keyframes look like an image, by the visual words they share."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.kernels import kernel
from prgbd.plugins.slam.orb_gtsam.loop_closing.vocabulary import Vocabulary

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
DescriptorArray = NDArray[np.uint64]


class KeyframeDatabase:
    """Finds keyframes by their appearance, with a vocabulary that it learns from them.

    No vocabulary has to be downloaded: it is learned from the first keyframe and learned anew each time the number of
    keyframes has doubled, from a bounded sample of their descriptors, until ``learn_until`` keyframes; then it stays.
    So the cost per keyframe is constant in the mean. Words are weighted by TF-IDF and images compared by the L1 score
    of bags of words (DBoW2; Galvez-Lopez and Tardos, T-RO 2012). There is no inverted file: keyframes of one recording
    share so many words that reading all of them in order (3 ms for 1000 keyframes of 2000 features) is cheap enough.

    One thread may change the index while others ask it.

    Args:
        branching: Children per node of the vocabulary tree.
        depth: Levels of the tree.
        sample: Most descriptors that the vocabulary is learned from.
        learn_until: The vocabulary stays as it is after this many keyframes.
        seed: Seed of sampling and clustering.
    """

    def __init__(
        self, *, branching: int = 10, depth: int = 5, sample: int = 100_000, learn_until: int = 512, seed: int = 0
    ) -> None:
        self.branching, self.depth, self.sample, self.learn_until, self.seed = (
            branching,
            depth,
            sample,
            learn_until,
            seed,
        )
        self.vocabulary: Vocabulary | None = None
        self._idf: FloatArray = np.zeros(0)
        self._added = 0
        self._learn_at = 1
        # Kept only as long as the vocabulary may change.
        self._descriptors: dict[int, DescriptorArray] = {}
        self._bags = _Bags()
        self._lock = threading.RLock()

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self._bags.row_of)

    def __contains__(self, k: int) -> bool:
        """Whether keyframe ``k`` is indexed."""
        return k in self._bags.row_of

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the lock, which cannot be pickled."""
        return {name: value for name, value in self.__dict__.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the state of another index."""
        self.__dict__.update(state)
        self._lock = threading.RLock()

    def add(self, k: int, descriptors: DescriptorArray) -> None:
        """Add a keyframe, or replace it.

        Args:
            k: Its number.
            descriptors: (N, 4) uint64.
        """
        self._added += 1
        if self._learn_at <= self.learn_until:
            self._descriptors[k] = np.array(descriptors, np.uint64)
            if self._added >= self._learn_at:
                self._learn()
                return
        with self._lock:
            self._bags.put(k, *self._bag(descriptors))

    def remove(self, k: int) -> None:
        """Remove a keyframe; nothing happens if it is not indexed."""
        self._descriptors.pop(k, None)
        with self._lock:
            self._bags.drop(k)

    def query(
        self, descriptors: DescriptorArray, *, exclude: Iterable[int] = (), count: int | None = None
    ) -> tuple[IntArray, FloatArray]:
        """Find the keyframes that look most like an image.

        Args:
            descriptors: (N, 4) uint64 of the image.
            exclude: Keyframes that are not wanted.
            count: Return at most this many; None for all that share a word.

        Returns:
            Keyframes (M,) int64 and scores (M,) float64 in (0, 1], best first; equals by number.
        """
        with self._lock:
            if self.vocabulary is None or len(descriptors) == 0:
                return np.zeros(0, np.int64), np.zeros(0)
            bags = self._bags
            scores = bags.scores(*self._bag(descriptors), len(self.vocabulary))
            for k in exclude:
                if k in bags.row_of:
                    scores[bags.row_of[k]] = 0.0
            order = np.lexsort((bags.keyframe[: len(scores)], -scores))
            order = order[: np.count_nonzero(scores)][:count]
            return bags.keyframe[order].copy(), scores[order]

    def score(self, a: int, b: int) -> float:
        """Return how alike two indexed keyframes are, 0 to 1.

        Raises:
            KeyError: If one of them is not indexed.
        """
        with self._lock:
            return self._bags.score(a, b)

    def _bag(self, descriptors: DescriptorArray) -> tuple[IntArray, FloatArray]:
        """Return the words of an image in order and their weights, which add up to 1."""
        assert self.vocabulary is not None
        words, counts = np.unique(self.vocabulary.words(descriptors), return_counts=True)
        weights = counts * self._idf[words]
        return words, weights / max(weights.sum(), 1e-12)

    def _learn(self) -> None:
        """Learn the vocabulary from the keyframes and sort them anew; readers see the old one until it is done."""
        while self._learn_at <= self._added:
            self._learn_at *= 2
        known = list(self._descriptors.items())
        rng = np.random.default_rng([self.seed, self._added])
        every = np.concatenate([descriptors for _, descriptors in known])
        if len(every) == 0:
            self._learn_at = self._added + 1
            return
        if len(every) > self.sample:
            every = every[np.sort(rng.choice(len(every), self.sample, replace=False))]
        vocabulary = Vocabulary.learn(every, branching=self.branching, depth=self.depth, seed=self.seed)
        found = [np.unique(vocabulary.words(descriptors), return_counts=True) for _, descriptors in known]
        seen = np.bincount(np.concatenate([words for words, _ in found]), minlength=len(vocabulary))
        # One more image than there are, so that a word which all of them have still counts for a little.
        idf = np.log((len(known) + 1) / np.maximum(seen, 1))
        bags = _Bags()
        for (k, _), (words, counts) in zip(known, found, strict=True):
            weights = counts * idf[words]
            bags.put(k, words, weights / max(weights.sum(), 1e-12))
        with self._lock:
            self.vocabulary, self._idf, self._bags = vocabulary, idf, bags
        if self._learn_at > self.learn_until:
            self._descriptors.clear()


class _Bags:
    """Bags of words in the rows of growing arrays; a dropped keyframe's row is used again."""

    def __init__(self) -> None:
        self.row_of: dict[int, int] = {}
        self.free: list[int] = []
        self.keyframe = np.full(16, -1, np.int64)
        self.size = np.zeros(16, np.int64)
        self.words = np.zeros((16, 256), np.int32)
        self.weights = np.zeros((16, 256), np.float32)

    def put(self, k: int, words: IntArray, weights: FloatArray) -> None:
        """Write the bag of keyframe ``k``: words in order and their weights."""
        self.drop(k)
        row = self.free.pop() if self.free else len(self.row_of)
        self._reserve(row + 1, len(words))
        self.row_of[k] = row
        self.keyframe[row], self.size[row] = k, len(words)
        self.words[row, : len(words)], self.weights[row, : len(words)] = words, weights

    def drop(self, k: int) -> None:
        """Forget keyframe ``k`` if it is there."""
        row = self.row_of.pop(k, None)
        if row is not None:
            self.keyframe[row], self.size[row] = -1, 0
            self.free.append(row)

    def scores(self, words: IntArray, weights: FloatArray, vocabulary: int) -> FloatArray:
        """Return the score of every row for a bag; 0 in unused rows."""
        asked = np.zeros(vocabulary, np.float32)
        asked[words] = weights
        found: FloatArray = _scores(asked, self.words, self.weights, self.size[: len(self.row_of) + len(self.free)])
        return found

    def score(self, a: int, b: int) -> float:
        """Return the score of two keyframes."""
        i, j = self.row_of[a], self.row_of[b]
        _, at_a, at_b = np.intersect1d(
            self.words[i, : self.size[i]], self.words[j, : self.size[j]], assume_unique=True, return_indices=True
        )
        return float(np.minimum(self.weights[i, at_a], self.weights[j, at_b]).sum(dtype=np.float64))

    def _reserve(self, rows: int, columns: int) -> None:
        have_rows, have_columns = self.words.shape
        if rows <= have_rows and columns <= have_columns:
            return
        shape = (
            have_rows if rows <= have_rows else max(rows, 2 * have_rows),
            have_columns if columns <= have_columns else max(columns, 2 * have_columns),
        )
        for name in ("words", "weights"):
            old = getattr(self, name)
            larger = np.zeros(shape, old.dtype)
            larger[:have_rows, :have_columns] = old
            setattr(self, name, larger)
        extra = shape[0] - have_rows
        self.keyframe = np.concatenate([self.keyframe, np.full(extra, -1, np.int64)])
        self.size = np.concatenate([self.size, np.zeros(extra, np.int64)])


@kernel()
def _scores(asked: np.ndarray, words: np.ndarray, weights: np.ndarray, size: np.ndarray) -> np.ndarray:
    """L1 scores of normalised bags: 1 - |a - b| / 2, which is the sum over common words of the smaller weight."""
    out = np.zeros(len(size))
    for row in range(len(size)):
        total = 0.0
        for i in range(size[row]):
            total += min(asked[words[row, i]], weights[row, i])
        out[row] = total
    return out
