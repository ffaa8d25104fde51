"""What every task leaves at the end: ``metrics.csv``, ``report.html`` and a table on the terminal."""

from __future__ import annotations

from typing import Any

from prgbd.cli.job import Job


def report(job: Job, summary: dict[str, Any]) -> None:
    """Write the report of a finished task and print its figures."""
    from prgbd.report.page import write_report
    from prgbd.report.tables import print_summary, write_metrics_csv

    write_metrics_csv(summary, job.store.path("metrics.csv"))
    write_report(job.store.folder)
    print_summary(summary, job.display.console)
    job.display.say(f"Report: {job.shown(job.store.path('report.html'))}")
