"""Sums of squared differences of the integrated signal: what all deviations are made of.

With x the running sum of the samples (x[0] = 0), m the averaging factor and d the order of the difference,
every deviation is a mean of squares of sum over a of c_a x[t + a m], c = (1, -2, 1) or (1, -3, 3, -1).  Only
differences whose whole span lies in one run of samples are taken.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit


@njit
def integrate(values: FloatArray, offset: float) -> FloatArray:
    """Return the running sum of values - offset, (n + 1,), beginning with 0."""
    total = np.empty(len(values) + 1)
    total[0] = 0.0
    for k in range(len(values)):
        total[k + 1] = total[k] + (values[k] - offset)
    return total


@njit(fastmath={"reassoc"})
def _allan_run(x: FloatArray, start: int, count: int, m: int, stride: int) -> float:
    total = 0.0
    for k in range(count):
        t = start + k * stride
        difference = x[t + 2 * m] - 2.0 * x[t + m] + x[t]
        total += difference * difference
    return total


@njit(fastmath={"reassoc"})
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
def allan_sum(x: FloatArray, starts: IntArray, stops: IntArray, m: int, stride: int) -> tuple[float, int]:
    """Return the sum of squared second differences, and their number.

    Parameters
    ----------
    x : array, (n + 1,)
        From `integrate`.
    starts, stops : arrays of int64
        Runs: samples start..stop, so that x[start] ... x[stop] belong to the run.
    stride : int
        Differences begin at every stride-th sample of a run; 1 takes them all.
    """
    total, number = 0.0, 0
    for run in range(len(starts)):
        positions = stops[run] - starts[run] - 2 * m + 1
        if positions > 0:
            count = (positions + stride - 1) // stride
            total += _allan_run(x, starts[run], count, m, stride)
            number += count
    return total, number


@njit
def all_sums(x: FloatArray, starts: IntArray, stops: IntArray, m: int) -> tuple[FloatArray, IntArray]:
    """Return sums of squares and their numbers for Allan, modified Allan and Hadamard, (3,) each.

    Arguments as for `allan_sum`, of which the first equals that with stride 1; one pass for all three.
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
        if second > 0:
            sums[0] += _allan_run(x, start + third, second - third, m, 1)
            numbers[0] += second
    return sums, numbers
