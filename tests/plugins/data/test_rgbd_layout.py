"""True poses of other rates and clocks than a motion capture's."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from prgbd.plugins.data._rgbd_layout import true_poses

START = 1305031229.5
TIMES = START + np.arange(121) / 30


def write(path: Path, times: np.ndarray) -> Path:
    rows = [f"{time:.6f} {time - START:.6f} 0 0 0 0 0 1" for time in times]
    path.write_text("\n".join(rows))
    return path


def known(poses: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))


def test_poses_at_5_hz_are_interpolated_and_larger_gaps_are_not(tmp_path, caplog):
    times = START + np.arange(21) / 5
    with caplog.at_level(logging.WARNING, "prgbd"):
        poses = true_poses(write(tmp_path / "p.txt", times), TIMES)
    assert "one every 0.2 s" in caplog.text
    assert len(known(poses)) == len(TIMES)
    np.testing.assert_allclose(poses[:, 0, 3], TIMES - START, atol=1e-5)
    gap = true_poses(write(tmp_path / "p.txt", np.delete(times, range(5, 10))), TIMES)
    assert set(range(25, 60)) - set(known(gap)) == set(range(25, 60))


@pytest.mark.parametrize(("rate", "images"), [(100, 121), (30, 121), (0.5, 3)])
def test_other_rates(tmp_path, rate, images):
    times = START + np.arange(4 * rate + 1) / rate
    poses = true_poses(write(tmp_path / "p.txt", times), TIMES)
    assert len(known(poses)) == pytest.approx(images, abs=2)


def test_true_poses_of_another_time_are_said_to_be_none(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, "prgbd"):
        assert true_poses(write(tmp_path / "p.txt", TIMES + 500), TIMES) is None
    assert "do not meet" in caplog.text
    assert "There are no true poses" in caplog.text
    assert true_poses(tmp_path / "absent.txt", TIMES) is None
