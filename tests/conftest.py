"""Fixtures that all tests share."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

# Several worker processes on a small machine: more threads in each only slow all of them down.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session", autouse=True)
def _one_torch_thread() -> None:
    import torch

    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def golden() -> Path:
    """The folder of golden figures."""
    return Path(__file__).parent / "golden"


def _finder(folder: str) -> Callable[[str], Path]:
    def find(path: str) -> Path:
        found = ROOT.parent / "shared" / folder / path
        if not found.exists():
            pytest.skip(f"needs ../shared/{folder}/{path}, which is not on this machine")
        return found

    return find


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Real recordings and published weights beside the checkout, by their path; without them the test is skipped."""
    return _finder("data")


@pytest.fixture(scope="session")
def shared_reference() -> Callable[[str], Path]:
    """Reference figures of other programs beside the checkout, by their path; without them the test is skipped."""
    return _finder("reference")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what needs ``../shared``: ``-m shared`` runs those tests alone, ``-m "not shared"`` runs the rest."""
    for item in items:
        if {"shared_data", "shared_reference"} & set(getattr(item, "fixturenames", ())):
            item.add_marker("shared")
