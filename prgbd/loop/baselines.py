"""Trajectories that the loop is compared with: SLAM on the images alone, and the pose network's chained motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from prgbd.core.data import Sequence
from prgbd.core.export import write_slam_folder
from prgbd.core.slam import GeometricSLAM
from prgbd.loop.loop_settings import LoopSettings
from prgbd.loop.monitor import Monitor
from prgbd.loop.slam_runs import describe_pose, pose_figures, run_slam, sensor_input
from prgbd.loop.store import RunStore

NAMES = {"mono": "RGB SLAM", "posenet": "pose network"}


def run_baseline(
    kind: str,
    make_slam: Callable[[], GeometricSLAM],
    sequences: list[Sequence],
    settings: LoopSettings,
    store: RunStore,
    monitor: Monitor,
) -> dict[str, Any]:
    """Run a system on the images of recordings alone; what is finished is not done again.

    Args:
        kind: ``mono`` or ``posenet``; results lie in ``baselines/KIND/slam/SEQ``.
        make_slam: Makes a system with mode ``mono``.
        sequences: The recordings.
        settings: Seed, alignment and export formats of the run.
        store: Remembers the run.
        monitor: Who watches.

    Returns:
        An entry like those of the summary's ``loops``, with the ``folder`` of its results instead of a number.
    """
    folder = f"baselines/{kind}"

    def localise(sequence: Sequence) -> dict[str, Any]:
        given = sensor_input(sequence, "mono", None)
        result = run_slam(make_slam, sequence, given, seed=settings.seed, monitor=monitor)
        with store.new_folder(store.path(folder, "slam", sequence.name)) as target:
            write_slam_folder(result, target, settings.export, frame=sequence.frame)
        return pose_figures(result, sequence, settings.alignment)

    monitor.say(f"Baseline: {NAMES[kind]}")
    pose: dict[str, Any] = {}
    for sequence in sequences:
        step = f"{folder}/slam/{sequence.name}"
        pose[sequence.name] = store.step(step, lambda chosen=sequence: localise(chosen))  # type: ignore[misc]
        monitor.say("  " + describe_pose(sequence.name, pose[sequence.name]))
    return {"name": NAMES[kind], "folder": folder, "pose": pose, "depth": None, "training": None}
