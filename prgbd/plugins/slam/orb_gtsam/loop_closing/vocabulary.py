"""A visual vocabulary: binary descriptors sorted into words by a tree of cluster centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.features.matching import hamming
from prgbd.plugins.slam.orb_gtsam.kernels import kernel

IntArray = NDArray[np.int64]
DescriptorArray = NDArray[np.uint64]

# Rounds of clustering at a node; the assignments hardly change after these.
_ROUNDS = 8


@dataclass(frozen=True)
class Vocabulary:
    """A tree of cluster centres; its leaves are the words.

    Made by hierarchical k-majority clustering: k-means for bits, where the centre of a cluster takes in every bit the
    value that most of its members have (Galvez-Lopez and Tardos, "Bags of Binary Words for Fast Place Recognition in
    Image Sequences", T-RO 2012).

    Attributes:
        centre: (M, 4) uint64 centre of every node; the root is node 0.
        first_child: (M,) int64 first child of every node; the others follow it.
        children: (M,) int64 number of children, 0 for a leaf.
        word: (M,) int64 word of every leaf, -1 for inner nodes.
    """

    centre: DescriptorArray
    first_child: IntArray
    children: IntArray
    word: IntArray

    @classmethod
    def learn(
        cls, descriptors: DescriptorArray, *, branching: int = 10, depth: int = 5, smallest: int = 4, seed: int = 0
    ) -> Vocabulary:
        """Cluster descriptors into words.

        Args:
            descriptors: (N, 4) uint64 with N >= 1.
            branching: Most children of a node.
            depth: Levels below the root, so there are at most ``branching ** depth`` words.
            smallest: Clusters of at most this many descriptors are not split.
            seed: Seed of the first centres.

        Returns:
            The vocabulary; equal arguments give an equal one.
        """
        centre, first_child, children = _learn(
            np.ascontiguousarray(descriptors, np.uint64), branching, depth, max(smallest, 1), seed
        )
        leaf = children == 0
        return cls(centre, first_child, children, np.where(leaf, np.cumsum(leaf) - 1, -1))

    def __len__(self) -> int:
        """Return the number of words."""
        return int(self.word.max()) + 1

    def words(self, descriptors: DescriptorArray) -> IntArray:
        """Return the word of every descriptor, (N,) int64 for (N, 4) uint64."""
        descriptors = np.ascontiguousarray(descriptors, np.uint64)
        found: IntArray = _descend(descriptors, self.centre, self.first_child, self.children, self.word)
        return found


@kernel()
def _descend(
    descriptors: np.ndarray, centre: np.ndarray, first_child: np.ndarray, children: np.ndarray, word: np.ndarray
) -> np.ndarray:
    found = np.empty(len(descriptors), np.int64)
    for i in range(len(descriptors)):
        node = 0
        while children[node] > 0:
            first = first_child[node]
            best, nearest = 1 << 20, first
            for c in range(first, first + children[node]):
                d = hamming(descriptors[i], centre[c])
                if d < best:
                    best, nearest = d, c
            node = nearest
        found[i] = word[node]
    return found


@kernel()
def _learn(
    descriptors: np.ndarray, branching: int, depth: int, smallest: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = len(descriptors)
    most = 1 + depth * n  # A level has at most as many nodes as there are descriptors.
    power = 1
    total = 1
    for _ in range(depth):
        power *= branching
        total += power
        if total > most:
            break
    most = min(most, total)
    centre = np.zeros((most, 4), np.uint64)
    first_child, children = np.full(most, -1, np.int64), np.zeros(most, np.int64)
    start, stop, level = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.int64)
    order, sorted_order = np.arange(n), np.empty(n, np.int64)
    label = np.zeros(n, np.int64)
    stop[0] = n
    nodes, node = 1, 0
    state = np.array([np.uint64(seed) * np.uint64(2654435761) + np.uint64(88172645463325252)], np.uint64)
    # Breadth first, so that the children of a node follow each other.
    while node < nodes:
        a, b = start[node], stop[node]
        if level[node] < depth and b - a > smallest:
            centres = _cluster(descriptors, order[a:b], label, branching, state)
            if len(centres) > 1:
                first_child[node], children[node] = nodes, len(centres)
                at = a
                for c in range(len(centres)):
                    centre[nodes] = centres[c]
                    start[nodes], level[nodes] = at, level[node] + 1
                    for i in range(a, b):
                        if label[order[i]] == c:
                            sorted_order[at] = order[i]
                            at += 1
                    stop[nodes] = at
                    nodes += 1
                order[a:b] = sorted_order[a:b]
        node += 1
    return centre[:nodes].copy(), first_child[:nodes].copy(), children[:nodes].copy()


@kernel()
def _random(state: np.ndarray) -> float:
    """Return the next number in [0, 1) of an xorshift generator, so that no global state is touched."""
    x = state[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    state[0] = x
    return float(x >> np.uint64(11)) / 9007199254740992.0


@kernel()
def _cluster(
    descriptors: np.ndarray, members: np.ndarray, label: np.ndarray, branching: int, state: np.ndarray
) -> np.ndarray:
    """Cluster some descriptors by k-majority and write their labels; return the centres, none of them empty."""
    centres = _first_centres(descriptors, members, branching, state)
    k = len(centres)
    ones, size = np.empty((k, 256), np.int64), np.empty(k, np.int64)
    for i in range(len(members)):
        label[members[i]] = -1
    for _ in range(_ROUNDS):
        changed = 0
        ones[:] = 0
        size[:] = 0
        for i in range(len(members)):
            m = members[i]
            best, nearest = 1 << 20, 0
            for c in range(k):
                d = hamming(descriptors[m], centres[c])
                if d < best:
                    best, nearest = d, c
            changed += label[m] != nearest
            label[m] = nearest
            size[nearest] += 1
            for w in range(4):
                bits = descriptors[m, w]
                for b in range(64):
                    ones[nearest, 64 * w + b] += np.int64((bits >> np.uint64(b)) & np.uint64(1))
        if changed == 0:
            break
        for c in range(k):
            if size[c] > 0:
                _majority(ones[c], size[c], centres[c])
    # The centres that are kept get the numbers 0, 1, ...
    number, kept = np.full(k, -1, np.int64), 0
    for c in range(k):
        if size[c] > 0:
            number[c] = kept
            centres[kept] = centres[c]
            kept += 1
    for i in range(len(members)):
        label[members[i]] = number[label[members[i]]]
    return centres[:kept]


@kernel()
def _majority(ones: np.ndarray, size: int, centre: np.ndarray) -> None:
    for w in range(4):
        bits = np.uint64(0)
        for b in range(64):
            if 2 * ones[64 * w + b] > size:
                bits |= np.uint64(1) << np.uint64(b)
        centre[w] = bits


@kernel()
def _first_centres(descriptors: np.ndarray, members: np.ndarray, k: int, state: np.ndarray) -> np.ndarray:
    """Choose descriptors far from each other as k-means++ does; fewer where there are fewer different ones."""
    n = len(members)
    centres = np.empty((k, 4), np.uint64)
    nearest = np.full(n, 1 << 20, np.int64)
    chosen = members[int(_random(state) * n)]
    for c in range(k):
        centres[c] = descriptors[chosen]
        total = 0.0
        for i in range(n):
            d = hamming(descriptors[members[i]], centres[c])
            nearest[i] = min(nearest[i], d)
            total += nearest[i] * nearest[i]
        if total == 0.0:
            return centres[: c + 1]
        left = _random(state) * total
        for i in range(n):
            if nearest[i] > 0:
                chosen = members[i]
                left -= nearest[i] * nearest[i]
                if left < 0.0:
                    break
    return centres
