"""Sums of squared differences of the integrated signal: what all deviations are made of.

With x the running sum of the samples (x[0] = 0), m the averaging factor and d the order of the difference,
every deviation is a mean of squares of sum over a of c_a x[t + a m], c = (1, -2, 1) or (1, -3, 3, -1).  Only
differences whose whole span lies in one run of samples are taken.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from imumon.blocks import FloatArray, IntArray

ALLAN_ORDER, HADAMARD_ORDER = 2, 3


@njit(cache=True, nogil=True)
def integrate(values: FloatArray, offset: float) -> FloatArray:
    """Return the running sum of values - offset, (n + 1,), beginning with 0."""
    total = np.empty(len(values) + 1)
    total[0] = 0.0
    for k in range(len(values)):
        total[k + 1] = total[k] + (values[k] - offset)
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _allan_run(x: FloatArray, start: int, count: int, m: int, stride: int) -> float:
    total = 0.0
    for k in range(count):
        t = start + k * stride
        difference = x[t + 2 * m] - 2.0 * x[t + m] + x[t]
        total += difference * difference
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _hadamard_run(x: FloatArray, start: int, count: int, m: int) -> float:
    total = 0.0
    for k in range(count):
        t = start + k
        difference = x[t + 3 * m] - 3.0 * x[t + 2 * m] + 3.0 * x[t + m] - x[t]
        total += difference * difference
    return total


@njit(cache=True, nogil=True)
def _modified_run(x: FloatArray, start: int, count: int, m: int) -> float:
    window = 0.0
    for t in range(start, start + m):
        window += x[t + 2 * m] - 2.0 * x[t + m] + x[t]
    total = window * window
    for t in range(start, start + count - 1):
        window += x[t + 3 * m] - 3.0 * x[t + 2 * m] + 3.0 * x[t + m] - x[t]
        total += window * window
    return total


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def hadamard_sum(x: FloatArray, starts: IntArray, stops: IntArray, m: int) -> tuple[float, int]:
    """Return the sum of squared third differences, and their number; arguments as for `allan_sum`."""
    total, number = 0.0, 0
    for run in range(len(starts)):
        count = stops[run] - starts[run] - 3 * m + 1
        if count > 0:
            total += _hadamard_run(x, starts[run], count, m)
            number += count
    return total, number


@njit(cache=True, nogil=True)
def modified_sum(x: FloatArray, starts: IntArray, stops: IntArray, m: int) -> tuple[float, int]:
    """Return the sum of squares of m second differences added up, and their number.

    The window of m differences is moved along; its rounding stays below 1e-9 of the result for 1e8 samples.
    """
    total, number = 0.0, 0
    for run in range(len(starts)):
        count = stops[run] - starts[run] - 3 * m + 2
        if count > 0:
            total += _modified_run(x, starts[run], count, m)
            number += count
    return total, number
