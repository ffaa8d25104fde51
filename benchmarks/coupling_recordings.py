"""The recordings of ``coupling.py``, each with its network; no option is set for any of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import prgbd
from prgbd.core.data import Sequence

DEMO = {"id": "monodepth2", "weights": "demo"}
RT = {"id": "rt_monodepth", "weights": "weights/rt_monodepth_s/ms_640_192"}
STREETS = (*range(8), 201, 202, 203)
STREET_FRAMES, INDOOR_FRAMES = 120, 200
ROOM, OUTDOORS = 10.0, 80.0


@dataclass(frozen=True)
class Recording:
    """A recording, its network, and where it is read from: ``root`` below the data folder, "" for a synthetic world."""

    name: str
    plugin: str
    root: str
    sequence: str | None
    network: dict[str, str]
    frames: int | None = None
    depth_cap: float = OUTDOORS


RECORDINGS = (
    Recording("kitti_small", "kitti_odometry", "kitti_small", "00", RT),
    Recording("kitti00", "kitti_odometry", "kitti_odometry", "00", RT),
    Recording("redkitchen", "seven_scenes", "seven_scenes", None, DEMO, depth_cap=ROOM),
    Recording("fr1rpy", "tum_rgbd", "tum_rgbd", None, DEMO, depth_cap=ROOM),
    *(
        Recording(f"street-{i}", "synthetic", "", f"street-{i}", DEMO, STREET_FRAMES)
        for i in (*range(8), 201, 202, 203)
    ),
    *(Recording(f"indoor-{i}", "synthetic", "", f"indoor-{i}", DEMO, INDOOR_FRAMES, ROOM) for i in range(2)),
)


def opened(recording: Recording, data: Path) -> Sequence:
    """Open a recording."""
    names = None if recording.sequence is None else [recording.sequence]
    if recording.root:
        return prgbd.make_sequences(recording.plugin, names, root=str(data / recording.root))[0]
    return prgbd.make_sequences(recording.plugin, names, frames=recording.frames)[0]


def network_of(recording: Recording, data: Path) -> dict[str, str]:
    """Return id and weights of the network of a recording."""
    network = dict(recording.network)
    if network["weights"] != "demo":
        network["weights"] = str(data / network["weights"])
    return network
