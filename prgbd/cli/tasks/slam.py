"""``task=slam``: one SLAM run per sequence, on the network's depth, the sensor's depth, or none."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from prgbd.cli import settings
from prgbd.cli.job import Job
from prgbd.cli.tasks.reporting import report
from prgbd.core.data import Sequence
from prgbd.core.errors import ConfigError
from prgbd.io.export import save_result
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.pose_refinement import step_name
from prgbd.loop.self_improving import SelfImprovingLoop
from prgbd.loop.slam_runs import describe_pose, pose_figures, run_slam, sensor_input
from prgbd.loop.summary import write_summary, write_truth

NAMES = {"mono": "RGB", "rgbd": "RGB-D", "stereo": "Stereo"}


def run(job: Job) -> None:
    """Run SLAM on every sequence and write the report.

    Raises:
        ConfigError: If one file would have to take the maps of several recordings.
    """
    several = len(job.parts.sequences) + len(job.parts.test_sequences) > 1
    if several and isinstance(settings.map_files(job.config).save, Path):
        raise ConfigError("slam.save_map names one file for the maps of several recordings; use slam.save_map=true.")
    report(job, _on_pseudo_depth(job) if job.parts.mode == "pseudo_rgbd" else _on_recording(job))


def _on_pseudo_depth(job: Job) -> dict[str, Any]:
    """The self-improving loop without a refinement."""
    parts, config = job.parts, job.config
    assert parts.estimator is not None
    assert parts.make_slam is not None
    loop = LoopParts(
        estimator=parts.estimator,
        make_slam=parts.make_slam,
        sequences=[*parts.sequences, *parts.test_sequences],
        settings=replace(settings.loop_settings(config, parts.baseline), max_loops=0),
        store=job.store,
        identity=settings.identity(config, parts),
        trainer=job.trainer,
        monitor=job.display,
        make_viewer=settings.viewer_maker(config),
    )
    return SelfImprovingLoop(loop).run()


def _on_recording(job: Job) -> dict[str, Any]:
    sequences = [*job.parts.sequences, *job.parts.test_sequences]
    job.store.step("truth", lambda: write_truth(job.store, sequences))
    pose: dict[str, Any] = {}
    for sequence in sequences:
        pose[sequence.name] = job.store.step(step_name(0, "slam", sequence.name), partial(_localise, job, sequence))
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
    return write_summary(job.store, settings.identity(job.config, job.parts), sequences, [entry], seconds=seconds)


def _localise(job: Job, sequence: Sequence) -> dict[str, Any]:
    parts = job.parts
    assert parts.make_slam is not None
    given = sensor_input(sequence, parts.mode, parts.baseline)
    make_viewer = settings.viewer_maker(job.config)
    viewer = None if make_viewer is None else make_viewer(sequence, job.store.path("viz", f"00-{sequence.name}"))
    maps = settings.map_files(job.config)
    result = run_slam(
        parts.make_slam,
        sequence,
        given,
        seed=int(job.config["seed"]),
        monitor=job.display,
        viewer=viewer,
        load_map=maps.load,
        save_map=maps.target(job.store.folder, sequence.name),
    )
    with job.store.new_folder(job.store.loop(0, "slam", sequence.name)) as folder:
        save_result(result, folder, settings.export_formats(job.config), frame=sequence.frame)
    return pose_figures(result, sequence, str(job.config["evaluation"]["alignment"]))
