"""What must hold of the recordings of a run."""

from __future__ import annotations

from collections.abc import Iterable

from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError, DataError
from prgbd.core.validation import check_name


def check_recordings(sequences: Iterable[Sequence]) -> None:
    """Refuse recordings that cannot be told apart or have no proper name, and those without motion.

    Raises:
        ConfigError: If two have one name.
        ContractError: If a name cannot be that of a folder.
        DataError: If one has fewer than two frames.
    """
    seen = set()
    for sequence in sequences:
        check_name(sequence.name, f"The recording of {type(sequence).__name__}")
        if sequence.name in seen:
            raise ConfigError(
                f"The sequence '{sequence.name}' is named twice in data.sequences and data.test_sequences."
            )
        seen.add(sequence.name)
        if len(sequence) < 2:
            raise DataError(f"The sequence '{sequence.name}' has {len(sequence)} frame; SLAM needs at least two.")
