"""Sums of squared differences of the integrated signal: what all deviations are made of.

With x the running sum of the samples (x[0] = 0), m the averaging factor and d the order of the difference,
every deviation is a mean of squares of sum over a of c_a x[t + a m], c = (1, -2, 1) or (1, -3, 3, -1).  Only
differences whose whole span lies in one run of samples are taken.  The sums are compiled: in NumPy they take
three times as long (an hour of six channels at 400 Hz: 2 s), and a hundred times with a gap every 20 samples.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import inner, njit


def integrate(values: FloatArray, offset: float) -> FloatArray:
    """Return the running sum of values - offset, (n + 1,), beginning with 0."""
    total = np.zeros(len(values) + 1)
    np.cumsum(values - offset, out=total[1:])
    return total


@inner(fastmath={"reassoc"})
def _all_runs(x: FloatArray, start: int, positions: int, m: int, window: float) -> tuple[float, float, float]:
    """Return the sums of squares of second differences, third differences, and windows of m of the second.

    The step from one window to the next is the third difference.  The rounding of the windows stays below
    1e-9 of the result for 1e8 samples.
    """
    allan, hadamard, modified = 0.0, 0.0, window * window
    for k in range(positions):
        t = start + k
        near, far = x[t + m] - x[t], x[t + 2 * m] - x[t + m]
        second = far - near
        third = x[t + 3 * m] - x[t + 2 * m] - far - second
        allan += second * second
        hadamard += third * third
        window += third
        modified += window * window
    return allan, hadamard, modified


@njit
def all_sums(x: FloatArray, starts: IntArray, stops: IntArray, m: int) -> tuple[FloatArray, IntArray]:
    """Return sums of squares and their numbers for Allan, modified Allan and Hadamard, (3,) each.

    Parameters
    ----------
    x : array, (n + 1,)
        From `integrate`.
    starts, stops : arrays of int64
        Runs: samples start..stop, so that x[start] ... x[stop] belong to the run.
    """
    sums, numbers = np.zeros(3), np.zeros(3, np.int64)
    for run in range(len(starts)):
        start, length = starts[run], stops[run] - starts[run]
        second = length - 2 * m + 1
        third = max(0, second - m)
        if second >= m:
            window = 0.0
            for t in range(start, start + m):
                window += x[t + 2 * m] - 2.0 * x[t + m] + x[t]
            allan, hadamard, modified = _all_runs(x, start, third, m, window)
            sums += np.array([allan, modified, hadamard])
            numbers[1] += third + 1
            numbers[2] += third
        for t in range(start + third, start + second):
            difference = x[t + 2 * m] - 2.0 * x[t + m] + x[t]
            sums[0] += difference * difference
        numbers[0] += max(0, second)
    return sums, numbers
