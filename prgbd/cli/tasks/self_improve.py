"""``task=self_improve``: the self-improving loop."""

from __future__ import annotations

from typing import Any

from prgbd.cli import settings
from prgbd.cli.job import Job
from prgbd.cli.tasks.reporting import report
from prgbd.loop.baselines import run_baseline
from prgbd.loop.self_improving import SelfImprovingLoop


def run(job: Job) -> None:
    """Run the loop and write its report."""
    parts, config = job.parts, job.config
    assert parts.estimator is not None
    assert parts.make_slam is not None
    baselines = _baselines(job)
    loop = SelfImprovingLoop(
        parts.estimator,
        parts.make_slam,
        parts.sequences,
        settings.refinement_settings(config),
        settings.loop_settings(config, parts.baseline),
        job.store,
        settings.identity(config, parts),
        trainer=job.trainer,
        test_sequences=parts.test_sequences,
        depth_tests=parts.depth_tests,
        monitor=job.display,
        make_viewer=settings.viewer_maker(config),
        more={"baselines": baselines} if baselines else None,
    )
    report(job, loop.run())


def _baselines(job: Job) -> list[dict[str, Any]]:
    """Run what ``task.baselines`` names on the test recordings, or on all if there are none.

    One that teaches the network runs on all.
    """
    parts, config = job.parts, job.config
    options = settings.loop_settings(config, None)
    tested = parts.test_sequences or parts.sequences
    everything = [*parts.sequences, *parts.test_sequences]
    return [
        run_baseline(
            kind, make, everything if kind == options.first_teacher else tested, options, job.store, job.display
        )
        for kind, make in parts.make_baselines.items()
    ]
