"""Trajectories that the loop is compared with: SLAM on the images alone, and the pose network's chained motions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from prgbd.core.data import Sequence
from prgbd.core.errors import PrgbdError
from prgbd.core.registry import REGISTRY
from prgbd.core.slam import GeometricSLAM
from prgbd.core.types import SlamResult
from prgbd.io.export import load_result, save_result
from prgbd.loop.loop_settings import LoopSettings
from prgbd.loop.monitor import Monitor
from prgbd.loop.outcome import Failures
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
    failures: Failures | None = None,
) -> dict[str, Any]:
    """Run a system on the images of recordings alone; what is finished is not done again.

    Args:
        kind: ``mono`` or ``posenet``; results lie in ``baselines/KIND/slam/SEQ``.
        make_slam: Makes a system with mode ``mono``.
        sequences: The recordings.
        settings: Seed, alignment and export formats of the run.
        store: Remembers the run.
        monitor: Who watches.
        failures: Keeps the errors of single recordings; those that failed are left out.

    Returns:
        An entry like those of the summary's ``loops``, with the ``folder`` of its results instead of a number.
    """
    monitor.say(f"Baseline: {NAMES[kind]}")
    pose: dict[str, Any] = {}
    failures = failures or Failures(1, monitor)
    for sequence in failures.spare(sequences):
        with failures.of(sequence.name):
            pose[sequence.name] = localise(kind, make_slam, sequence, settings, store, monitor)
            monitor.say("  " + describe_pose(sequence.name, pose[sequence.name]))
    return {"name": NAMES[kind], "folder": _folder(kind), "pose": pose, "depth": None, "training": None}


def baseline_makers(
    names: Iterable[str], make_slam: Callable[[], GeometricSLAM], network: Mapping[str, Any]
) -> dict[str, Callable[[], GeometricSLAM]]:
    """Return what makes the baselines: the run's own SLAM for ``mono``, and the pose network beside depth.weights.

    Args:
        names: The baselines.
        make_slam: Makes the run's own SLAM.
        network: ``id`` and options of the depth network.

    Raises:
        PrgbdError: If there is no pose network; it is found now, not after hours of other baselines.
    """
    posenet = partial(REGISTRY.make, "slam", "posenet", depth=network["id"], weights=network.get("weights"))
    known: dict[str, Callable[[], GeometricSLAM]] = {"mono": make_slam, "posenet": posenet}
    made = {name: known[name] for name in names}
    try:
        if "posenet" in made:
            made["posenet"]().close()
    except PrgbdError as error:
        raise type(error)(f"task.baselines=[posenet] cannot run: {error}") from error
    return made


def localise(
    kind: str,
    make_slam: Callable[[], GeometricSLAM],
    sequence: Sequence,
    settings: LoopSettings,
    store: RunStore,
    monitor: Monitor,
) -> dict[str, Any]:
    """Run a system on the images of one recording alone, unless the store has its result; return the pose figures.

    Args:
        kind: As for ``run_baseline``, like the other arguments.
        make_slam: Makes the system.
        sequence: The recording.
        settings: Seed, alignment and export formats.
        store: Remembers the run.
        monitor: Who watches.
    """

    def work() -> dict[str, Any]:
        given = sensor_input(sequence, "mono", None)
        result = run_slam(make_slam, sequence, given, seed=settings.seed, monitor=monitor)
        with store.new_folder(store.path(_folder(kind), "slam", sequence.name)) as target:
            save_result(result, target, settings.export, frame=sequence.frame)
        return pose_figures(result, sequence, settings.evaluation.alignment)

    figures: dict[str, Any] = store.step(f"{_folder(kind)}/slam/{sequence.name}", work)
    return figures


def baseline_result(kind: str, sequence: Sequence, store: RunStore) -> SlamResult:
    """Read what ``localise`` left in the store."""
    return load_result(store.path(_folder(kind), "slam", sequence.name, "result.npz"))


def _folder(kind: str) -> str:
    return f"baselines/{kind}"
