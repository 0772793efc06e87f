"""The Allan deviation of a stream, octave by octave, in constant memory.

The definition is the overlapping one, with the differences of averaging factor m taken at every
max(1, m // 16)-th sample of a run: all of them up to m = 31, sixteen to each averaging time above.  The sums
are those over a whole record but for rounding, however the stream is cut into blocks.  Taking every
difference, as `imumon.allan.analysis.variances` does, changes an octave by a small part of its own
uncertainty.

For each octave a ring of the last 64 running sums is kept, one a stride, of which a difference looks back at
two: 18 kB for a channel, for averaging times of up to 2^35 samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.allan.covariance import NOISES, TRUSTED_FREEDOM, Runs, freedom, intervals
from imumon.allan.series import JITTER, nominal_interval_ns
from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit, record

DENSE = 4
"""Up to this octave differences are taken at every sample."""
STRIDES_PER_TAU = 1 << DENSE
RINGS, RING = 36, 64
"""Octaves, and running sums that are kept of each."""
LEARN = 64
"""Samples from which the interval is learned; as many steps in a row that do not fit it begin anew."""
_SLOPES = np.array([-1.0, 0.0, 1.0, -2.0])
"""Exponent of the Allan variance over tau of each of `NOISES`."""


class _Run:
    """What is carried from sample to sample."""

    interval_ns: float
    offset: float
    """Time from sample to sample, 0 while it is being learned; what is taken from every value."""
    rings: FloatArray
    """Running sums at the last strides of each octave, (RINGS, RING)."""
    sums: FloatArray
    counts: IntArray
    """Of the squared differences, (RINGS,)."""
    position: int
    """Samples in the run; -1: there is no run."""
    total: float
    """Running sum of the run."""
    time_ns: int
    segment: int
    """Of the last sample."""
    misfits: int
    """Steps in a row that did not fit the interval."""


@njit
def stream(time_ns: IntArray, segment: IntArray, values: FloatArray, run: _Run) -> int:
    """Add samples, NaN where there is none; return how many rows were used, all unless the interval fails."""
    for row in range(len(values)):
        value = values[row]
        if np.isnan(value):
            continue
        if run.position >= 0:
            step = (time_ns[row] - run.time_ns) / run.interval_ns
            if segment[row] != run.segment or abs(step - 1.0) > JITTER:
                run.position = -1
                run.misfits += 1
            else:
                run.misfits = 0
        run.time_ns, run.segment = time_ns[row], segment[row]
        if run.misfits >= LEARN:
            return row
        if run.position < 0:
            run.position = 0
            run.total = 0.0
            run.rings[:, 0] = 0.0
        run.position += 1
        run.total += value - run.offset
        position, now = run.position, run.total
        for octave in range(RINGS):
            shift, back = max(octave - DENSE, 0), 1 << min(octave, DENSE)
            stride = position >> shift
            if stride << shift != position:
                break
            ring = run.rings[octave]
            ring[stride & (RING - 1)] = now
            if stride >= 2 * back:
                middle, first = ring[(stride - back) & (RING - 1)], ring[(stride - 2 * back) & (RING - 1)]
                difference = now - 2.0 * middle + first
                run.sums[octave] += difference * difference
                run.counts[octave] += 1
    return len(values)


class LiveCurve(NamedTuple):
    """Allan deviations so far, (n,) each, with intervals of `imumon.allan.covariance.CONFIDENCE`."""

    tau_s: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    freedom: FloatArray

    def trusted(self) -> LiveCurve:
        """Return the part with enough degrees of freedom."""
        few = np.flatnonzero(self.freedom < TRUSTED_FREEDOM)
        n = int(few[0]) if len(few) else len(self.tau_s)
        return LiveCurve(*(part[:n] for part in self))


class StreamingAllan:
    """Allan deviation of one channel of a stream."""

    def __init__(self) -> None:
        self.restarts = 0
        """How often the rate changed, and everything began anew."""
        self._begin()

    def _begin(self) -> None:
        self._waiting: list[tuple[IntArray, IntArray, FloatArray]] = []
        """Samples from which the interval is not learned yet."""
        self._run = record(_Run, rings=(RINGS, RING), sums=RINGS, counts=RINGS)
        self._run.position = -1

    def process(self, time_ns: IntArray, segment: IntArray, values: FloatArray) -> None:
        """Add samples, (n,) each; NaN where the channel has none.

        A gap, a restart or an uneven step ends the run: no difference crosses it.
        """
        start = 0
        while start < len(values):
            if not self._run.interval_ns:
                start = self._learn(time_ns, segment, values, start)
            else:
                start += stream(time_ns[start:], segment[start:], values[start:], self._run)
                if start < len(values):
                    self._begin()
                    self.restarts += 1

    def _learn(self, time_ns: IntArray, segment: IntArray, values: FloatArray, start: int) -> int:
        """Gather samples until the interval is known, then add them; return the next row."""
        lacking = LEARN - sum(len(part) for *_, part in self._waiting)
        rows = (start + np.flatnonzero(np.isfinite(values[start:])))[:lacking]
        self._waiting.append((time_ns[rows], segment[rows], values[rows]))
        if len(rows) < lacking:
            return len(values)
        times, segments, first = (np.concatenate(part) for part in zip(*self._waiting, strict=True))
        self._waiting.clear()
        self._run.interval_ns = nominal_interval_ns(times, segments)
        self._run.offset = float(first[0])
        if self._run.interval_ns:
            stream(times, segments, first, self._run)
        return int(rows[-1]) + 1

    def curve(self) -> LiveCurve:
        """Return the curve so far; empty while there is none."""
        run = self._run
        n = int(np.count_nonzero(run.counts))
        m = 2.0 ** np.arange(n)
        stride = np.maximum(1.0, m / STRIDES_PER_TAU)
        variance = run.sums[:n] / run.counts[:n] / (2.0 * m**2)
        length = (run.counts[:n] - 1) * stride + 2.0 * m
        # Sixteen differences to an averaging time are those of an averaging factor of 16.
        used = np.minimum(m, STRIDES_PER_TAU)
        runs = [Runs(np.array([length]), np.ones(1)) for length in used * length / m]
        noises = np.eye(len(NOISES))[identify(variance)]
        edf = np.array([freedom("allan", int(m), *of) for m, *of in zip(used, runs, noises, strict=True)])
        tau_s = np.asarray(m * run.interval_ns * 1e-9, np.float64)
        return LiveCurve(tau_s, np.sqrt(variance), *intervals(variance, edf), edf)


def identify(variance: FloatArray) -> IntArray:
    """Return which of `NOISES` each octave is most like, (n,), by the slope of the curve around it."""
    if len(variance) < 2:
        return np.zeros(len(variance), np.int64)
    logs = np.log2(np.maximum(variance, 1e-300))
    slope = np.gradient(logs)
    return np.asarray(np.abs(slope[:, np.newaxis] - _SLOPES).argmin(axis=1), np.int64)
