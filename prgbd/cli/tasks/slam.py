"""``task=slam``: one SLAM run per sequence, on the network's depth, the sensor's depth, or none."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from prgbd.cli.job import Job, look_at
from prgbd.cli.tasks.reporting import report
from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError
from prgbd.io.disk import require_writable
from prgbd.io.export import save_result
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.outcome import Failures
from prgbd.loop.pose_refinement import step_name
from prgbd.loop.self_improving import SelfImprovingLoop
from prgbd.loop.slam_runs import describe_pose, pose_figures, run_slam, sensor_input
from prgbd.loop.summary import write_summary, write_truth
from prgbd.loop.viewing import viewer_maker

NAMES = {"mono": "RGB", "rgbd": "RGB-D", "stereo": "Stereo"}


def run(job: Job) -> None:
    """Run SLAM on every sequence and write the report.

    Raises:
        ConfigError: If one file would have to take the maps of several recordings.
        DiskError: If a map cannot be saved where it is to lie.
    """
    several = len(job.parts.sequences) + len(job.parts.test_sequences) > 1
    if several and isinstance(job.options.slam.maps.save, Path):
        raise ConfigError("slam.save_map names one file for the maps of several recordings; use slam.save_map=true.")
    for sequence in (*job.parts.sequences, *job.parts.test_sequences):
        target = job.options.slam.maps.target(job.store.folder, sequence.name)
        if target is not None:
            require_writable(target, "slam.save_map")
    report(job, _on_pseudo_depth(job) if job.parts.mode == "pseudo_rgbd" else _on_recording(job))


def _on_pseudo_depth(job: Job) -> dict[str, Any]:
    """The self-improving loop without a refinement."""
    parts = job.parts
    assert parts.estimator is not None
    assert parts.make_slam is not None
    loop = LoopParts(
        estimator=parts.estimator,
        make_slam=parts.make_slam,
        sequences=[*parts.sequences, *parts.test_sequences],
        settings=job.options.loop,
        store=job.store,
        identity=job.identity,
        trainer=job.trainer,
        monitor=job.display,
        make_viewer=viewer_maker(job.options.viz or "none"),
        look=look_at,
    )
    return SelfImprovingLoop(loop).run()


def _on_recording(job: Job) -> dict[str, Any]:
    sequences = [*job.parts.sequences, *job.parts.test_sequences]
    job.store.step("truth", lambda: write_truth(job.store, sequences))
    pose: dict[str, Any] = {}
    failures = Failures(len(sequences), job.display)
    for sequence in sequences:
        with failures.of(sequence.name):
            work = partial(_localise, job, sequence)
            pose[sequence.name] = job.store.step(step_name(0, "slam", sequence.name), work)
            job.display.say("  " + describe_pose(sequence.name, pose[sequence.name]))
    entry = {
        "loop": 0,
        "name": NAMES[job.parts.mode],
        "pose": pose,
        "depth": None,
        "training": None,
        "baseline": {name: figures["baseline"] for name, figures in pose.items()},
        "depth_max": {},
    }
    seconds = sum(figures["seconds"] or 0.0 for figures in pose.values())
    return write_summary(job.store, job.identity, sequences, [entry], seconds=seconds, errors=failures.reasons)


def _localise(job: Job, sequence: Sequence) -> dict[str, Any]:
    parts, options = job.parts, job.options
    assert parts.make_slam is not None
    given = sensor_input(sequence, parts.mode, parts.baseline)
    make_viewer = viewer_maker(options.viz or "none")
    viewer = None if make_viewer is None else make_viewer(sequence, job.store.path("viz", f"00-{sequence.name}"))
    result = run_slam(
        parts.make_slam,
        sequence,
        given,
        seed=options.seed,
        monitor=job.display,
        viewer=viewer,
        load_map=options.slam.maps.load,
        save_map=options.slam.maps.target(job.store.folder, sequence.name),
    )
    with job.store.new_folder(job.store.loop(0, "slam", sequence.name)) as folder:
        save_result(result, folder, options.export, frame=sequence.frame)
    return pose_figures(result, sequence, options.evaluation.alignment, look_at)
