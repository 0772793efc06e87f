"""Live Allan curves, octave by octave, in constant memory: a stage of the pipeline that makes charts.

The definition is the overlapping one, with the differences of averaging factor m taken at every
max(1, m // 16)-th sample of a run: all of them up to m = 31, sixteen to each averaging time above.  The sums
are those over a whole record but for rounding, however the stream is cut into blocks.  Taking every
difference, as `imumon.allan.analysis.variances` does, changes an octave by a small part of its own
uncertainty.

For each octave a ring of the last 64 running sums is kept, one a stride, of which a difference looks back at
two: 18 kB for a channel, for averaging times of up to 2^35 samples.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import ColumnArray, Columns, FloatArray, IntArray, SampleBlock
from imumon.charts import AXIS_COLORS, GREY, Axis, Chart, Curve
from imumon.clock.checks import usual_interval_ns
from imumon.columns import Column
from imumon.compiled import njit, record
from imumon.recordings.reduced import ACCEL, GYRO

from .covariance import TERMS_OF, TRUSTED_FREEDOM, Runs, freedom, intervals
from .series import JITTER, WALK

DENSE = 4
"""Up to this octave differences are taken at every sample."""
STRIDES_PER_TAU = 1 << DENSE
RINGS, RING = 36, 64
"""Octaves, and running sums that are kept of each."""
LEARN = 64
"""Samples from which the interval is learned; as many steps in a row that do not fit it begin anew."""
MEASURED = {"gyro": "angular rate", "accel": "specific force"}


class _Run:
    """What is carried from sample to sample."""

    interval_ns: float
    offset: float  # time from sample to sample, 0 while it is being learned; what is taken from every value
    rings: FloatArray  # running sums at the last strides of each octave, (RINGS, RING)
    sums: FloatArray
    counts: IntArray  # of the squared differences, (RINGS,)
    position: int  # samples in the run; -1: there is no run
    total: float  # running sum of the run
    time_ns: int
    segment: int  # of the last sample
    misfits: int  # steps in a row that did not fit the interval


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
    """Allan deviations so far, (n,) each, with intervals of `imumon.allan.covariance.CONFIDENCE`.

    They are those of a random walk of the rate, which no other noise has wider ones than.
    """

    tau_s: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    freedom: FloatArray

    def trusted(self) -> "LiveCurve":
        """Return the part up to the first averaging time without enough degrees of freedom."""
        n = np.argmax([*(self.freedom < TRUSTED_FREEDOM), True])
        return LiveCurve(*(part[:n] for part in self))


class StreamingAllan:
    """Allan deviation of one channel of a stream."""

    def __init__(self) -> None:
        self.restarts = 0  # how often the rate changed, and everything began anew
        self._begin()

    def _begin(self) -> None:
        self._waiting: list[ColumnArray] = [np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)]
        """Times, segments and values from which the interval is not learned yet."""
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
        rows = (start + np.flatnonzero(np.isfinite(values[start:])))[: LEARN - len(self._waiting[0])]
        fresh = time_ns[rows], segment[rows], values[rows]
        self._waiting = [np.append(*parts) for parts in zip(self._waiting, fresh, strict=True)]
        times, segments, first = self._waiting
        if len(first) < LEARN:
            return len(values)
        self._begin()
        steps = np.diff(times)
        self._run.interval_ns, _ = usual_interval_ns(steps[(np.diff(segments) == 0) & (steps > 0)])
        self._run.offset = first[0]
        if self._run.interval_ns:
            stream(times, segments, first, self._run)
        return int(rows[-1]) + 1

    def curve(self) -> LiveCurve:
        """Return the curve so far; empty while there is none."""
        run = self._run
        n = np.count_nonzero(run.counts)
        m = 2.0 ** np.arange(n)
        stride = np.maximum(1.0, m / STRIDES_PER_TAU)
        variance = run.sums[:n] / run.counts[:n] / (2.0 * m**2)
        length = (run.counts[:n] - 1) * stride + 2.0 * m
        # Sixteen differences to an averaging time are those of an averaging factor of 16.
        used = np.minimum(m, STRIDES_PER_TAU)
        runs = [Runs(np.array([length]), np.ones(1)) for length in used * length / m]
        edf = np.array([freedom("allan", int(m), of, WALK) for m, of in zip(used, runs, strict=True)])
        tau_s = np.asarray(m * run.interval_ns * 1e-9, np.float64)
        return LiveCurve(tau_s, np.sqrt(variance), *intervals(variance, edf), edf)


class AllanStage:
    """Allan deviations of the gyros and accelerometers, as they come.

    With a column ``at_rest`` only samples at rest count; motion ends a run as a gap does.
    """

    columns: Sequence[Column] = ()  # None: a curve over averaging time is not a quantity of each sample

    def __init__(self) -> None:
        self._channels: dict[str, StreamingAllan] = {}

    def process(self, block: SampleBlock) -> Columns:
        """Take the samples of a block; needs ``device_time_ns`` and ``segment``."""
        rest = block.columns.get("at_rest")
        for name in (*GYRO, *ACCEL):
            if name in block:
                values: FloatArray = np.asarray(block[name], np.float64)
                if rest is not None:
                    values = np.where(rest == 1, values, np.nan)
                channel = self._channels.setdefault(name, StreamingAllan())
                channel.process(block["device_time_ns"], block["segment"], values)
        return {}

    def notices(self) -> list[str]:
        """Return how often the rate has changed and the curves began anew."""
        restarts = max((channel.restarts for channel in self._channels.values()), default=0)
        text = f"the sample rate changed, {restarts} times so far: the Allan curves begin anew"
        return [text] if restarts else []

    def charts(self) -> Sequence[Chart]:
        """Return one log-log chart per sensor; none while no averaging time can be trusted."""
        charts = []
        for group, measured in MEASURED.items():
            level = TERMS_OF[group]["bias_instability"]
            channels = {axis: self._channels.get(f"{group}_{axis}") for axis in AXIS_COLORS}
            found = {axis: one.curve().trusted() for axis, one in channels.items() if one is not None}
            shown = {axis: curve for axis, curve in found.items() if len(curve.tau_s) > 1}
            if shown:
                x = Axis("averaging time [s]", log=True)
                y = Axis(f"Allan deviation [{level.shown}]", log=True)
                curves = tuple(_curves(shown, level.factor))
                notes = tuple(_note(axis, curve, group) for axis, curve in found.items())
                title = f"Allan deviation of the {measured}, at rest; upright bars: 68 % intervals"
                charts.append(Chart(f"allan_{group}", "Allan", title, x, y, curves, notes=notes))
        return charts


def allan_stage(*_: object) -> list[AllanStage]:
    """Return the stage, whatever the setup."""
    return [AllanStage()]


def _curves(shown: Mapping[str, LiveCurve], factor: float) -> Iterator[Curve]:
    """Yield the curve of each axis, upright bars over their intervals, and the line of white noise."""
    for axis, curve in shown.items():
        yield Curve(axis, curve.tau_s, factor * curve.deviation, AXIS_COLORS[axis], width=2.0)
    for axis, curve in shown.items():
        x = np.repeat(curve.tau_s, 3)
        y = factor * np.column_stack([curve.low, curve.high, np.full_like(curve.low, np.nan)]).ravel()
        yield Curve(f"68 % {axis}", x, y, AXIS_COLORS[axis], width=1.0, listed=False)
    # Slope -1/2, through the longest curve where its random walk is read.
    curve = max(shown.values(), key=lambda one: len(one.tau_s))
    near = _at_1_s(curve)
    line = factor * curve.deviation[near] * np.sqrt(curve.tau_s[near] / curve.tau_s)
    yield Curve("white noise", curve.tau_s, line, GREY, width=1.2, dashed=True)


def _note(axis: str, curve: LiveCurve, group: str) -> str:
    """Return what can be read off a curve: at 1 s the random walk, with its interval, and the lowest."""
    text = least = "-"
    if len(curve.tau_s):
        level, walk = TERMS_OF[group]["bias_instability"], TERMS_OF[group]["angle_random_walk"]
        near, lowest = _at_1_s(curve), np.argmin(curve.deviation)
        if 0.5 <= curve.tau_s[near] <= 2.0:
            scale = walk.factor * math.sqrt(curve.tau_s[near])
            reach = 0.5 * (curve.high[near] - curve.low[near]) * scale
            text = f"{curve.deviation[near] * scale:.3g} ± {reach:.2g} {walk.shown}"
        so_far = " so far" if lowest == len(curve.tau_s) - 1 else ""
        least = f"{level.factor * curve.deviation[lowest]:.3g} {level.shown}{so_far}"
    return f"{axis}  random walk {text:24} lowest {least}"


def _at_1_s(curve: LiveCurve) -> int:
    return int(np.argmin(np.abs(np.log(curve.tau_s))))
