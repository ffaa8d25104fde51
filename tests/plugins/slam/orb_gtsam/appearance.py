"""Made-up images for the tests of place recognition: sets of binary descriptors that share some, with flipped bits."""

from __future__ import annotations

import numpy as np


def descriptors(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random descriptors, (count, 4) uint64."""
    return rng.integers(0, 2**64, (count, 4), dtype=np.uint64)


def seen_again(rng: np.random.Generator, known: np.ndarray, flips: int = 15) -> np.ndarray:
    """Return descriptors with up to ``flips`` bits changed, as another image of the same things would have."""
    bits = np.unpackbits(known.view(np.uint8), axis=1)
    for row in bits:
        row[rng.integers(0, 256, flips)] ^= 1
    return np.packbits(bits, axis=1).view(np.uint64)


def walk(rng: np.random.Generator, places: int, features: int = 300, new: int = 60) -> list[np.ndarray]:
    """Return the descriptors of images along a walk: each drops the oldest ``new`` things and sees as many new ones."""
    things = descriptors(rng, features + new * places)
    return [seen_again(rng, things[i * new : i * new + features]) for i in range(places)]
