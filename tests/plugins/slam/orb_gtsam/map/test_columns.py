"""Columns that grow together and give back memory."""

from __future__ import annotations

import numpy as np
import pytest

from prgbd.plugins.slam.orb_gtsam.map.columns import _CAN_RELEASE, Columns


def columns() -> Columns:
    return Columns(
        label=((), np.int64, -1), wide=((700,), np.float32, 0), other=((300, 2), np.int64, -1), name=((2,), np.uint8, 7)
    )


def fill(table: Columns, rows: range) -> None:
    for row in rows:
        table.label[row], table.wide[row], table.other[row] = row, row, row


def test_new_rows_hold_fill_values_however_often_the_columns_grow() -> None:
    table = columns()
    for _ in range(50):
        first = table.grow(3)
        assert (table.label[first : first + 3] == -1).all()
        assert (table.other[first : first + 3] == -1).all()
        assert (table.name[first : first + 3] == 7).all()
        fill(table, range(first, first + 3))
    np.testing.assert_array_equal(table.label[:150], np.arange(150))
    np.testing.assert_array_equal(table.wide[:150, 699], np.arange(150))


def test_releasing_rows_leaves_their_neighbours_and_light_columns_alone() -> None:
    rng = np.random.default_rng(0)
    table = columns()
    table.grow(200)
    fill(table, range(200))
    gone = rng.permutation(200)[:120]
    for row in gone.tolist():
        table.release(row)
    kept = np.setdiff1d(np.arange(200), gone)
    for _ in range(2):
        np.testing.assert_array_equal(table.label[:200], np.arange(200))
        assert (table.wide[kept] == kept[:, None]).all()
        assert (table.other[kept] == kept[:, None, None]).all()
        first = table.grow(150)  # moves what is kept
        assert (table.other[first : first + 150] == -1).all()


@pytest.mark.skipif(not _CAN_RELEASE, reason="this platform keeps the memory")
def test_released_rows_take_no_memory() -> None:
    table = Columns(wide=((4096,), np.float64, 0))
    before = resident()
    for row in range(3000):
        table.grow(1)
        table.wide[row] = 1.0
        if row >= 20:
            table.release(row - 20)
    # 3000 rows are 98 MB.
    assert resident() - before < 10e6


def resident() -> float:
    with open("/proc/self/statm", encoding="ascii") as file:
        return float(file.read().split()[1]) * 4096
