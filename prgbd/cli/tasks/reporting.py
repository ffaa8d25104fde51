"""What every task leaves at the end: ``metrics.csv``, ``report.html`` and a table on the terminal."""

from __future__ import annotations

from typing import Any

from prgbd.cli.job import Job
from prgbd.loop.summary import write_results


def report(job: Job, summary: dict[str, Any]) -> None:
    """Write the report of a finished task and print its figures."""
    from prgbd.report.tables import print_summary

    written = write_results(job.store, summary)
    print_summary(summary, job.display.console)
    job.display.say(f"Report: {job.shown(written)}")
