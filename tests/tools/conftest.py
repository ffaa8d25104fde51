"""Tools work on runs of the command line."""

from tests.cli.conftest import cli, run

__all__ = ["cli", "run"]
