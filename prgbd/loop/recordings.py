"""What must hold of the recordings of a run."""

from __future__ import annotations

from collections.abc import Iterable

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, DataError


def check_recordings(sequences: Iterable[Sequence]) -> None:
    """Refuse recordings that cannot be told apart, and those without motion.

    Raises:
        ConfigError: If two have one name.
        DataError: If one has fewer than two frames.
    """
    seen = set()
    for sequence in sequences:
        if sequence.name in seen:
            raise ConfigError(
                f"The sequence '{sequence.name}' is named twice in data.sequences and data.test_sequences."
            )
        seen.add(sequence.name)
        if len(sequence) < 2:
            raise DataError(f"The sequence '{sequence.name}' has {len(sequence)} frame; SLAM needs at least two.")
