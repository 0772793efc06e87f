"""Samples of one axis gathered into means of a second at rest: what the slow filters live on.

A drift filter with a memory of minutes loses nothing by seeing means of a second, whatever the rate, and the
means hide what a low-pass in the device does to the noise of neighbouring samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from imumon.blocks import FloatArray, IntArray

SLOT_S = 1.0
LEAST_S = 0.5
"""A slot that saw the unit at rest for less than this is not believed: the motion may have begun in it."""
LONGEST = 4.0
"""A sample stands for so many usual intervals at most; the rest is a gap."""
MEMORY = 1.0 / 32.0
"""Weight of a new interval in the usual one."""

# State: seconds.
SUM, COVERED, INTERVAL = range(3)
# State: nanoseconds and flags.
BEGUN, SEGMENT, START_NS, LAST_NS, COUNT = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class Slots:
    """Slots that ended, in order.

    Parameters
    ----------
    row : array of int64, (m,)
        First row after the slot; from there on what the slot says is known.
    begins : array of bool, (m,)
        Whether a segment began with this slot.
    elapsed_s : array, (m,)
        From the begin of the slot to its end; longer than a second in a gap.
    covered_s : array, (m,)
        Time at rest with readings; 0 where the slot says nothing.
    mean : array, (m,)
        Mean reading, NaN where the slot says nothing.
    interval_s : array, (m,)
        Usual time between samples.
    """

    row: IntArray
    begins: npt.NDArray[np.bool_]
    elapsed_s: FloatArray
    covered_s: FloatArray
    mean: FloatArray
    interval_s: FloatArray

    def __len__(self) -> int:
        """Return the number of slots."""
        return len(self.row)


class SlotGatherer:
    """Gathers samples into slots, whatever the division into blocks; begins with the first usable sample."""

    def __init__(self) -> None:
        self._numbers = np.zeros(3)
        self._integers: IntArray = np.zeros(5, np.int64)

    def process(
        self, time_ns: IntArray, segment: IntArray, reading: FloatArray, measured: npt.NDArray[np.bool_]
    ) -> Slots:
        """Return the slots that end within these samples.

        Parameters
        ----------
        time_ns, segment : array of int64, (n,)
            Device time and the number of its segment; a new segment, or a time that runs back, begins anew.
        reading : array, (n,)
            Any unit; NaN where there is none.
        measured : array of bool, (n,)
            Whether the sample may be used: at rest.
        """
        n = len(reading)
        row, begins = np.empty(n, np.int64), np.empty(n, np.bool_)
        numbers = np.empty((4, n))
        m = _gather(time_ns, segment, reading, measured, self._numbers, self._integers, row, begins, numbers)
        return Slots(row[:m], begins[:m], *numbers[:, :m])


@njit(cache=True, nogil=True)
def _gather(
    time_ns: IntArray,
    segment: IntArray,
    reading: FloatArray,
    measured: npt.NDArray[np.bool_],
    numbers: FloatArray,
    integers: IntArray,
    row: IntArray,
    begins: npt.NDArray[np.bool_],
    out: FloatArray,
) -> int:
    """Fill row, begins and out (elapsed, covered, mean, interval) slot by slot; return how many."""
    m = 0
    for i in range(reading.size):
        use = measured[i] and np.isfinite(reading[i])
        t = time_ns[i]
        if integers[BEGUN] != 0 and (segment[i] != integers[SEGMENT] or t < integers[LAST_NS]):
            integers[BEGUN] = 0
            numbers[INTERVAL] = 0.0
        if integers[BEGUN] == 0:
            if not use:
                continue
            integers[BEGUN], integers[SEGMENT] = 2, segment[i]
            integers[START_NS] = integers[LAST_NS] = t
            integers[COUNT] = 0
            numbers[SUM] = numbers[COVERED] = 0.0
        dt = (t - integers[LAST_NS]) * 1e-9
        integers[LAST_NS] = t
        elapsed = (t - integers[START_NS]) * 1e-9
        if elapsed >= SLOT_S - 1e-6:
            believed = numbers[COVERED] >= LEAST_S
            row[m], begins[m] = i, integers[BEGUN] == 2
            out[0, m] = elapsed
            out[1, m] = numbers[COVERED] if believed else 0.0
            out[2, m] = numbers[SUM] / integers[COUNT] if believed else np.nan
            out[3, m] = numbers[INTERVAL]
            m += 1
            integers[BEGUN], integers[START_NS], integers[COUNT] = 1, t, 0
            numbers[SUM] = numbers[COVERED] = 0.0
        interval = numbers[INTERVAL]
        if interval == 0.0:
            numbers[INTERVAL] = dt
        else:
            dt = min(dt, LONGEST * interval)
            numbers[INTERVAL] += MEMORY * (dt - interval)
        if use:
            numbers[SUM] += reading[i]
            numbers[COVERED] += dt
            integers[COUNT] += 1
    return m


@njit(cache=True, nogil=True)
def spread(last: float, row: IntArray, values: FloatArray, broken: IntArray, out: FloatArray) -> float:
    """Fill `out` with what is shown at each row; return the last of it.

    That is the value of the last slot, and NaN from a row in `broken` to the next slot.
    """
    k, b = 0, 0
    for i in range(out.size):
        if b < broken.size and broken[b] == i:
            last = np.nan
            b += 1
        if k < row.size and row[k] == i:
            last = values[k]
            k += 1
        out[i] = last
    return last
