"""Files of SLAM's maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class MapFiles:
    """Where the maps of a SLAM system come from and go to.

    Attributes:
        load: File of the map that every recording starts in, or None.
        save: File to keep the map in; True for ``maps/SEQUENCE.npz`` in the run folder.
    """

    load: Path | None = None
    save: Path | bool = False

    def target(self, folder: Path, sequence: str) -> Path | None:
        """Return where the map of a recording goes, None if nowhere."""
        if isinstance(self.save, bool):
            return folder / "maps" / f"{sequence}.npz" if self.save else None
        return self.save
