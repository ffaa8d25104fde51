"""A Cholesky solver for the reduced system of bundle adjustment, kept by rows from their first nonzero on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prgbd.plugins.slam.orb_gtsam.kernels import FAST, kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel()
def envelope(column: IntArray, free: int, kf: IntArray, first: IntArray, offset: IntArray, start: IntArray) -> int:
    """Fill ``offset`` and ``start`` (6 F,) of the reduced system and return how many numbers its envelope holds."""
    lowest = np.arange(free)
    for q in range(len(first) - 1):
        low = free
        for m in range(first[q], first[q + 1]):
            if column[kf[m]] >= 0:
                low = min(low, column[kf[m]])
        for m in range(first[q], first[q + 1]):
            f = column[kf[m]]
            if f >= 0:
                lowest[f] = min(lowest[f], low)
    size = 0
    for f in range(free):
        begin = 6 * lowest[f]
        for i in range(6 * f, 6 * f + 6):
            start[i] = begin
            offset[i] = size - begin
            size += 6 * f + 6 - begin
    return size


@kernel(fastmath=FAST, forceinline=True)
def solve_envelope(S: FloatArray, offset: IntArray, start: IntArray, b: FloatArray) -> bool:
    """Solve ``S x = b`` in place (``b`` becomes ``x``) by Cholesky within the envelope; False if not positive definite.

    Row i has its first nonzero at column ``start[i]``; element (i, j) is ``S[offset[i] + j]``. ``S`` becomes L.
    """
    n = len(b)
    for i in range(n):
        oi = offset[i]
        for j in range(start[i], i + 1):
            oj = offset[j]
            s = S[oi + j]
            begin = max(start[i], start[j])
            row_i, row_j = S[oi + begin : oi + j], S[oj + begin : oj + j]
            for k in range(len(row_i)):
                s -= row_i[k] * row_j[k]
            if j < i:
                S[oi + j] = s / S[oj + j]
            elif s > 0.0:
                S[oi + i] = math.sqrt(s)
            else:
                return False
        s = b[i]
        for k in range(start[i], i):
            s -= S[oi + k] * b[k]
        b[i] = s / S[oi + i]
    for i in range(n - 1, -1, -1):
        b[i] /= S[offset[i] + i]
        for k in range(start[i], i):
            b[k] -= S[offset[i] + k] * b[i]
    return True
