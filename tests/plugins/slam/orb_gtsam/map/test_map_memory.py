"""Reuse of the map's memory."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam import OrbGtsamSLAM
from prgbd.plugins.slam.orb_gtsam.map import map as mapping
from tests.plugins.slam.orb_gtsam.walls import CAMERA, path, view


def run(quarantine: int, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, int, int]:
    """Return the positions, how many points were made, and how many rows they took."""
    monkeypatch.setattr(mapping, "_QUARANTINE", quarantine)
    with OrbGtsamSLAM(keyframes={"ratio": 2.0, "ratio_first": 2.0}, optimisation={"full_ba": False}) as system:
        system.reset(CAMERA, "rgbd", baseline=0.1, fps=10.0)
        for i, wTc in enumerate(path(30)):
            system.track(view(i, wTc))
        slam_map = system._map
        return system.finish().trajectory.positions, slam_map.counts.points_created, slam_map.points.count


def test_reusing_rows_of_culled_points_changes_nothing_but_the_memory(monkeypatch) -> None:
    plain, created, rows = run(1 << 30, monkeypatch)
    assert created == rows
    reused, created_again, fewer = run(3, monkeypatch)
    np.testing.assert_array_equal(reused, plain)
    assert created_again == created
    assert fewer < 0.95 * created
