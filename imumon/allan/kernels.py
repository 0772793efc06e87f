"""Sums of squared differences of the integrated signal: what all deviations are made of.

With x the running sum of the samples (x[0] = 0), m the averaging factor and d the order of the difference,
every deviation is a mean of squares of sum over a of c_a x[t + a m], c = (1, -2, 1) or (1, -3, 3, -1).  Only
differences whose whole span lies in one run of samples are taken.  The sums are compiled: in NumPy they take
three times as long (an hour of six channels at 400 Hz: 2 s), and a hundred times with a gap every 20 samples.

Where samples are missing within a run, the means are those of the samples that are there, and what the noise
of single samples makes of the differences is larger by a known factor (`losses`).
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.compiled import inner, njit


def integrate(values: FloatArray, offset: float) -> FloatArray:
    """Return the running sum of values - offset, (n + 1,), beginning with 0."""
    total = np.zeros(len(values) + 1)
    np.cumsum(values - offset, out=total[1:])
    return total


@inner(fastmath={"reassoc"})
def _second_differences(x: FloatArray, start: int, stop: int, m: int) -> float:
    """Return the sum of squares of the second differences that begin at start..stop."""
    total = 0.0
    for t in range(start, stop):
        difference = x[t + 2 * m] - 2.0 * x[t + m] + x[t]
        total += difference * difference
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
        if second > 0:
            sums[0] += _second_differences(x, start + third, start + second, m)
            numbers[0] += second
    return sums, numbers


@njit
def lossy_sums(
    x: FloatArray, count: IntArray, starts: IntArray, stops: IntArray, m: int
) -> tuple[FloatArray, IntArray]:
    """Return the same as `all_sums` where samples are missing within the runs, fewer than m in a row.

    Parameters
    ----------
    x : array, (n + 1,)
        From `integrate`, with zero for a sample that is missing.
    count : array of int64, (n + 1,)
        Running number of the samples that are there.
    starts, stops, m
        As of `all_sums`.
    """
    sums, numbers = np.zeros(3), np.zeros(3, np.int64)
    for run in range(len(starts)):
        start, second = starts[run], stops[run] - starts[run] - 2 * m + 1
        if second <= 0:
            continue
        means = np.empty(second + m)
        for k in range(second + m):
            t = start + k
            means[k] = m * (x[t + m] - x[t]) / (count[t + m] - count[t])
        window = 0.0
        for k in range(second):
            difference = means[k + m] - means[k]
            sums[0] += difference * difference
            window += difference
            if k >= m:
                before = means[k] - means[k - m]
                window -= before
                sums[2] += (difference - before) ** 2
            if k >= m - 1:
                sums[1] += window * window
        numbers += np.array([second, max(0, second - m + 1), max(0, second - m)])
    return sums, numbers


@njit
def losses(
    there: BoolArray, count: IntArray, starts: IntArray, stops: IntArray, m: int
) -> tuple[float, float]:
    """Return by what missing samples multiply the Allan variance of white noise and of quantization.

    The mean of c samples has the variance 1 / c of white noise instead of 1 / m.  Quantization, the
    difference of successive errors of the angle, cancels within a row of samples and leaves the two ends of
    each row; neighbouring means share an end where no sample is missing between them.
    """
    begun = np.zeros(len(count), np.int64)
    for k in range(len(there)):
        begun[k + 1] = begun[k] + (there[k] and (k == 0 or not there[k - 1]))
    white, ends, number = 0.0, 0.0, 0
    for run in range(len(starts)):
        for t in range(starts[run], stops[run] - 2 * m + 1):
            middle, end = t + m, t + 2 * m
            first, last = count[middle] - count[t], count[end] - count[middle]
            rows_first = begun[middle] - begun[t + 1] + there[t]
            rows_last = begun[end] - begun[middle + 1] + there[middle]
            white += 1.0 / first + 1.0 / last
            ends += rows_first / first**2 + rows_last / last**2
            if there[middle - 1] and there[middle]:
                ends += 1.0 / (first * last)
            number += 1
    return white * m / (2.0 * number), ends * m**2 / (3.0 * number)
