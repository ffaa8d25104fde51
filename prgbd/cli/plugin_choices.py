"""Which plug-ins were chosen, and what of ``slam.*``, ``depth.*`` and ``data.*`` is the run's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

from prgbd.core.option_ranges import Positive
from prgbd.core.options import from_mapping
from prgbd.io.reading import require_file
from prgbd.loop.map_files import MapFiles


@dataclass(frozen=True)
class PluginChoice:
    """A plug-in and its options.

    Attributes:
        id: Its id; "" where none is chosen.
        options: Keyword arguments of its constructor.
    """

    id: str = ""
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SlamChoice(PluginChoice):
    """The SLAM system.

    Attributes:
        mode: mono, rgbd (the sensor's depth), stereo (right images), pseudo_rgbd (the network's depth), or auto: the
            network's depth where there is a network, else what the recordings have.
        baseline: Virtual baseline in metres. auto adapts it to the network's depth (0.54 / 80 * largest depth);
            running adapts it to the frames so far, as on a live camera.
        load_map: A file that ``slam.save_map`` made, for every recording to start in.
        save_map: Keep the map: true for ``maps/SEQUENCE.npz`` in the run folder, or a file.

    Raises:
        ConfigError: If a value cannot work.
        DataError: If the map to load is missing.
    """

    mode: Literal["auto", "mono", "rgbd", "stereo", "pseudo_rgbd"] = "auto"
    baseline: Positive | Literal["auto", "adaptive", "running"] | None = "auto"
    load_map: Path | None = None
    save_map: bool | Path | None = False

    def __post_init__(self) -> None:
        if self.load_map is not None:
            require_file(self.load_map, "slam.load_map, a map that slam.save_map made")

    @property
    def fixed_baseline(self) -> float | None:
        """The baseline that the user fixed, metres, or None."""
        return self.baseline if isinstance(self.baseline, float) else None

    @property
    def maps(self) -> MapFiles:
        """Where SLAM's maps come from and go to."""
        return MapFiles(self.load_map, self.save_map or False)


@dataclass(frozen=True)
class DepthChoice(PluginChoice):
    """The depth network.

    Attributes:
        wrappers: What is put around the network, such as [flip_averaged].
    """

    wrappers: list[Any] | None = None


@dataclass(frozen=True)
class DataChoice(PluginChoice):
    """The recordings.

    Attributes:
        sequences: Names of the recordings to run on and train on; null for all that there are.
        test_sequences: Names of recordings that are evaluated but not trained on.
    """

    sequences: list[str] | str | None = None
    test_sequences: list[str] | str | None = None


C = TypeVar("C", bound=PluginChoice)
CHOICES: dict[str, type[PluginChoice]] = {"slam": SlamChoice, "depth": DepthChoice, "data": DataChoice}
LOOP_KEYS = {
    kind: tuple(f.name for f in fields(cls) if f.name not in ("id", "options")) for kind, cls in CHOICES.items()
}
"""By kind, the names in a plug-in's node that are no options of the plug-in."""


def read_choice(cls: type[C], node: Mapping[str, Any], kind: str) -> C:
    """Make the choice of a plug-in from its node of the configuration.

    What its YAML asks for (``???``) and nobody gave is left out; the registry says so when it makes the plug-in.

    Raises:
        ConfigError: If there are options without a plug-in, or one that the run reads cannot work.
    """
    own = {key: value for key, value in node.items() if key in ("id", *LOOP_KEYS[kind])}
    options = {str(key): value for key, value in node.items() if key not in own and value != "???"}
    return from_mapping(cls, {**own, "options": options}, kind)
