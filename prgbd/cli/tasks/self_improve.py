"""``task=self_improve``: the self-improving loop."""

from __future__ import annotations

from prgbd.cli import settings
from prgbd.cli.job import Job
from prgbd.cli.tasks.reporting import report
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.self_improving import SelfImprovingLoop


def run(job: Job) -> None:
    """Run the loop and write its report."""
    parts, config = job.parts, job.config
    assert parts.estimator is not None
    assert parts.make_slam is not None
    loop = LoopParts(
        estimator=parts.estimator,
        make_slam=parts.make_slam,
        sequences=parts.sequences,
        settings=settings.loop_settings(config, parts.baseline),
        store=job.store,
        identity=settings.identity(config, parts),
        refinement=settings.refinement_settings(config),
        trainer=job.trainer,
        test_sequences=parts.test_sequences,
        depth_tests=parts.depth_tests,
        baselines=parts.make_baselines,
        monitor=job.display,
        make_viewer=settings.viewer_maker(config),
    )
    report(job, SelfImprovingLoop(loop).run())
