"""One SLAM run over one sequence: frames in, ``SlamResult`` and its files out."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from prgbd.core.bare_starts import without_bare_starts
from prgbd.core.data import Sequence
from prgbd.core.depth_kind import DepthKind
from prgbd.core.errors import DataError
from prgbd.core.slam import GeometricSLAM, TrackingState
from prgbd.core.types import Frame, SlamResult
from prgbd.evaluation.metric_scale import scale_doubts
from prgbd.evaluation.trajectory import evaluate_trajectory
from prgbd.io.disk import require_writable
from prgbd.loop.monitor import Monitor, Progress, SilentMonitor
from prgbd.loop.outcome import Look, why_not_tracked
from prgbd.loop.sensing import DepthStatistics
from prgbd.loop.viewing import SilentViewer, SlamViewer
from prgbd.loop.work_time import WorkTime

# ORB-SLAM2's settings for the Kinect of TUM RGB-D: bf = 40 at f = 525 px (Examples/RGB-D/TUM1.yaml).
KINECT_BASELINE = 0.08
# What the progress line shows of a system's ``info``.
SHOWN = ("keyframes", "points", "maps")


@dataclass(frozen=True)
class SlamInput:
    """What SLAM is given for one sequence.

    Attributes:
        frames: The frames in order, with depth unless ``mode`` is ``mono``.
        mode: A mode of ``GeometricSLAM``; ``pseudo_rgbd`` works with every system that knows ``rgbd``.
        baseline: Metres, or None for ``mono``.
        statistics: What the pseudo depth looks like, or None for a sensor's depth.
        depth_kind: What the pseudo depth is.
    """

    frames: Iterable[Frame]
    mode: str
    baseline: float | None = None
    statistics: DepthStatistics | None = None
    depth_kind: DepthKind = DepthKind.SCALE


def sensor_input(sequence: Sequence, mode: str, baseline: float | None) -> SlamInput:
    """Make the input of SLAM from the recording alone.

    Args:
        sequence: The recording.
        mode: ``rgbd`` for the depth of its own sensor, ``stereo`` for its right images, or ``mono``.
        baseline: Metres that the user fixed; None takes the recording's own, else the Kinect's 0.08 m (``rgbd``).

    Raises:
        DataError: If ``rgbd`` is asked of a recording without depth, or with depth that is unknown everywhere, or
            ``stereo`` of one without right images.
    """
    frames = (sequence.frame(index) for index in range(len(sequence)))
    if mode == "mono":
        return SlamInput((frame.with_depth(None) for frame in frames), mode)
    if mode == "stereo":
        if sequence.frame(0).right is None or not (baseline or sequence.baseline):
            raise DataError(
                f"The sequence '{sequence.name}' has no right images with a known baseline, which slam.mode=stereo "
                "needs; use slam.mode=mono."
            )
        return SlamInput((frame.with_depth(None) for frame in frames), mode, baseline or sequence.baseline)
    if sequence.frame(0).depth is None:
        raise DataError(
            f"The sequence '{sequence.name}' has no depth sensor, which slam.mode=rgbd needs; use slam.mode=mono, or "
            "slam.mode=pseudo_rgbd with depth=ID."
        )
    if not any(frame.depth is not None and frame.depth.any() for frame in sequence):  # ends at the first with depth
        raise DataError(
            f"The depth of '{sequence.name}' is unknown at every pixel of every frame; check its depth files and the "
            "options data.depth_*, or use slam.mode=mono."
        )
    return SlamInput(frames, mode, baseline or sequence.baseline or KINECT_BASELINE)


def run_slam(
    make_slam: Callable[[], GeometricSLAM],
    sequence: Sequence,
    given: SlamInput,
    *,
    seed: int = 0,
    monitor: Monitor | None = None,
    viewer: SlamViewer | None = None,
    load_map: Path | None = None,
    save_map: Path | None = None,
) -> SlamResult:
    """Run a SLAM system over a sequence.

    Args:
        make_slam: Makes the system; it is closed at the end.
        sequence: The recording, for its camera and frame rate.
        given: Frames, mode and baseline.
        seed: Seed of everything random in the system.
        monitor: Who watches the progress.
        viewer: Who watches frames and map; it is closed at the end.
        load_map: File of a map to start in, see ``GeometricSLAM.load_map``.
        save_map: File to keep the map in.

    Returns:
        The system's result; its ``stats`` also hold ``seconds`` and ``fps``, both without the ``compile_seconds``,
        ``baseline`` and the depth's diagnostics. Frames of maps that never grew are lost, see ``without_bare_starts``.
    """
    monitor = monitor or SilentMonitor()
    keyframes = 0
    with (
        viewer or SilentViewer() as watching,
        make_slam() as system,
        _Stages(monitor, sequence.name) as stages,
    ):
        progress = stages.enter("SLAM", len(sequence))
        work = WorkTime(stages.leave_out)
        # A system without a mode of its own for pseudo depth takes it as a sensor's.
        mode = "rgbd" if given.mode == "pseudo_rgbd" and given.mode not in system.modes else given.mode
        system.expect_depth(given.depth_kind)
        system.reset(sequence.camera, mode, baseline=given.baseline, fps=sequence.fps, seed=seed)
        if load_map is not None:
            system.load_map(load_map)
        if save_map is not None:
            _require_save_map(system, save_map)
        for frame in given.frames:
            with work.measured():
                tracked = system.track(frame)
            keyframes += tracked.is_keyframe
            watching.tracked(frame, tracked, system)
            counts = {"keyframes": keyframes} | {k: tracked.info[k] for k in SHOWN if k in tracked.info}
            progress.advance(state=tracked.state.value, **counts)
        progress.advance(0, state="finishing")
        system.listen(stages.tell)
        with work.measured():
            result = system.finish()
        system.listen(None)
        watching.finished(result)
        if save_map is not None:
            system.save_map(save_map)
    noted: dict[str, Any] = {
        "seconds": work.seconds,
        "compile_seconds": work.compile_seconds,
        "fps": len(sequence) / max(work.seconds, 1e-9),
        "baseline": given.baseline or result.stats.get("baseline"),
        "seed": seed,
    }
    if given.statistics is not None:
        noted["pseudo_depth"] = given.statistics.diagnostics()
    counted = without_bare_starts(result)
    noted["bare_starts"] = result.stats.get("bare_starts", 0) + len(result.keyframes) - len(counted.keyframes)
    return replace(counted, stats={**result.stats, **noted})


class _Stages:
    """The stages of one SLAM run, one after the other: the frames, then what the system tells of its ``finish``."""

    def __init__(self, monitor: Monitor, name: str) -> None:
        self._monitor, self._name = monitor, name
        self._open: contextlib.AbstractContextManager[Progress] | None = None
        self._progress: Progress | None = None
        self._what, self._done = "", 0

    def enter(self, what: str, total: int) -> Progress:
        """Close the stage before and open one."""
        self.close()
        self._open = self._monitor.stage(f"{what} on {self._name}", total)
        self._progress = self._open.__enter__()
        self._what, self._done = what, 0
        return self._progress

    def tell(self, what: str, done: int, total: int) -> None:
        """A ``Listener`` that shows each thing as a stage."""
        if what != self._what or self._progress is None:
            self.enter(what, total)
        assert self._progress is not None
        self._progress.advance(max(0, done - self._done))
        self._done = max(self._done, done)

    def leave_out(self, seconds: float) -> None:
        """Say that the last seconds went into something else than the stage that is open."""
        if self._progress is not None:
            self._progress.leave_out(seconds)

    def close(self, *problem: Any) -> None:
        """Close the stage that is open."""
        if self._open is not None:
            opened, self._open, self._progress = self._open, None, None
            opened.__exit__(*(problem or (None, None, None)))

    def __enter__(self) -> _Stages:
        return self

    def __exit__(self, *problem: Any) -> None:
        self.close(*problem)


def _require_save_map(system: GeometricSLAM, path: Path) -> None:
    """Complain before the first frame, not after the last, if the map cannot be saved."""
    require_writable(path, "slam.save_map")
    plain = getattr(system, "unwrapped", system)
    if type(plain).save_map is GeometricSLAM.save_map:
        plain.save_map(path)


def pose_figures(
    result: SlamResult, sequence: Sequence, alignment: str = "sim3", look: Look | None = None
) -> dict[str, Any]:
    """Return the figures of one SLAM run for ``summary.json``, with pose errors where there is truth.

    Args:
        result: What ``run_slam`` returned.
        sequence: The recording.
        alignment: How the trajectory is brought to the truth.
        look: Looks for what is wrong with a recording in which nothing was tracked.
    """
    error = result.stats.get("depth_error") or {}
    figures = evaluate_trajectory(
        result.trajectory, len(sequence), sequence.poses, sequence.timestamps, alignment=alignment
    )
    return {
        **figures,
        "mode": result.mode,
        "fps": result.stats.get("fps"),
        "seconds": result.stats.get("seconds"),
        "keyframes": len(result.keyframes),
        "points": len(result.points),
        "lost_frames": sum(str(state) == TrackingState.LOST.value for state in result.states),
        "baseline": result.stats.get("baseline"),
        "depth_sigma": error.get("sigma"),
        "depth_shared": error.get("shared"),
        "doubts": [
            *result.stats.get("doubts", []),
            *scale_doubts(result, sequence.poses, sequence.depth_levels_per_metre),
        ],
        "failed": why_not_tracked(result, sequence, look),
    }


def describe_pose(name: str, figures: Mapping[str, Any]) -> str:
    """Return one line about a SLAM run."""
    parts = [f"{name}: {figures['tracked_frames']}/{figures['frames']} frames tracked"]
    if figures.get("ate_rmse") is not None:
        parts.append(f"ATE {figures['ate_rmse']:.3f} m ({figures['alignment']}, {figures['pairs']} poses)")
    parts.append(f"{figures['keyframes']} keyframes, {figures['points']} points")
    if figures.get("failed"):
        parts.append("failed: " + figures["failed"])
    if figures.get("doubts"):
        parts.append("doubtful: " + "; ".join(figures["doubts"]))
    if figures.get("depth_sigma") is not None:
        sigma, shared = figures["depth_sigma"], figures["depth_shared"]
        parts.append(f"depth errs by {sigma:.0%}, {shared:.0%} of the variance shared by a frame")
    if figures.get("fps"):
        parts.append(f"{figures['fps']:.1f} fps")
    return ", ".join(parts)
