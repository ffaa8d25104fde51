"""``task=self_improve``: the self-improving loop."""

from __future__ import annotations

from prgbd.cli.job import Job, look_at
from prgbd.cli.tasks.reporting import report
from prgbd.loop.loop_parts import LoopParts
from prgbd.loop.self_improving import SelfImprovingLoop
from prgbd.loop.viewing import viewer_maker


def run(job: Job) -> None:
    """Run the loop and write its report."""
    parts, options = job.parts, job.options
    assert parts.estimator is not None
    assert parts.make_slam is not None
    loop = LoopParts(
        estimator=parts.estimator,
        make_slam=parts.make_slam,
        sequences=parts.sequences,
        settings=options.loop,
        store=job.store,
        identity=job.identity,
        refinement=options.training,
        trainer=job.trainer,
        test_sequences=parts.test_sequences,
        depth_tests=parts.depth_tests,
        baselines=parts.make_baselines,
        monitor=job.display,
        make_viewer=viewer_maker(options.viz or "none"),
        look=look_at,
    )
    report(job, SelfImprovingLoop(loop).run())
