"""What no estimate may be made from: values no sensor has, saturated sensors, times that do not go on.

Stages receive such a value as missing and such a row not at all; tables keep both as they were sent.  An axis
that stays the same for long while another does not is reported, and a specific force in an impossible unit.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from .blocks import NO_INT, BoolArray, ColumnArray, Columns, FloatArray, IntArray, SampleBlock, missing
from .filters.slots import SlotGatherer, Slots
from .geodesy import STANDARD_GRAVITY
from .protocols.ranges import Ranges

RANGES: dict[str, tuple[float, float, str]] = {
    "gyro_": (-1e3, 1e3, "rad/s"),
    "accel_": (-1e6, 1e6, "m/s^2"),
    "mag_": (-1e9, 1e9, ""),
    "temperature": (-100.0, 250.0, "°C"),
    "pressure": (0.0, 1e10, "Pa"),
    "q_": (-2.0, 2.0, ""),
}
"""By the beginning of a column's name, what a sensor may read: three times the widest range that is sold,
32-bit counts of a magnetometer without unit, and of a thermometer, where no semiconductor works."""
LONGEST_GAP_S = 1e6
"""Within a segment, eleven days: a clock that leaps so far did not count."""
STUBBORN = 100
"""Rows in a row that go on from another time: then the clock was set, and a segment of its own begins."""
IMPOSSIBLE_AT_REST = {"gyro": (0.0, 2.0), "accel": (1.0, 30.0)}
"""What the largest axis reads at rest, at least and at most, rad/s and m/s^2: 115 °/s of bias, 3 g.

A sensor whose noise is below its step stands still at rest, rightly; beyond this it is saturated or dead.
"""
REPEATS = 3
"""A sensor may repeat a reading so often, and twice as often as it ever did at a reading possible at rest."""
UNCHANGED_NS = 30_000_000_000
"""An axis that stays the same for so long beside one that does not is reported: no hand turns a unit about
one axis for so long and keeps the others within a step."""
AT_AN_EDGE, BEYOND_CHANCE = 0.5, 3.0
"""Noise below a step changes at most this share of an axis' readings, where it is between two steps, while
the axes beside it may rightly stay on one; more by so many times the root of their number is no chance."""
GRAVITIES = (0.3, 3.0)
"""Of the specific force, its median: what has less falls and what has more is thrown, neither for minutes."""
BEYOND, LEAST_READINGS = 0.5, 50
"""Share beyond them, and number, of readings from which on these are doubted."""
LEAST_S, LONG_S = 5.0, 240.0
"""Least length of them at the end, and before: a rocket burns for two minutes, a parabola lasts for half."""
SLOWEST_HZ, FASTEST_HZ = 0.1, 40e3
"""Of samples: slower is no motion sensor, and the fastest that is sold has 32 kHz (ICM-42688)."""


class Taken(NamedTuple):
    """What stages see of a block: rows without values that are left out, and which these are; None: all."""

    block: SampleBlock
    rows: BoolArray | None

    def spread(self, column: ColumnArray) -> ColumnArray:
        """Return a column of the rows that were taken as one of all rows, missing in between."""
        if self.rows is None:
            return column
        whole = missing(len(self.rows), column.dtype)
        whole[self.rows] = column
        return whole


class Intake:
    """Keeps out of the stages what no estimate may be made from, and counts it.

    The result does not depend on the division into blocks.

    `ranges`: what is declared: from there on a reading is the end of the range, and what it was is unknown.
    """

    def __init__(self, ranges: Ranges) -> None:
        self._limits = ranges.limits()
        """By the beginning of a column's name: what is inside, and what is reported of the rest."""
        for start, (low, high, unit) in RANGES.items():
            self._limits[start] = low, high, f"beyond {low:g} to {high:g} {unit}".rstrip()
        self._clock = _Clock()
        self._still = {sensor: _Still(*limits) for sensor, limits in IMPOSSIBLE_AT_REST.items()}
        self._unchanged = [_Unchanged(sensor) for sensor in IMPOSSIBLE_AT_REST]
        self._begun: set[str] = set()
        """Gyros and thermometers that have begun to read: not only zero, nor gyros their first reading."""
        self._first: FloatArray | None = None
        """First reading of the gyros."""
        self._force = SpecificForce()
        self._left_out: Counter[str] = Counter()
        self._reported: set[str] = set()

    @property
    def left_out(self) -> int:
        """Values and rows that were left out so far."""
        return self._left_out.total()

    def process(self, block: SampleBlock) -> Taken:
        """Return what the stages may see of a block."""
        timely, rows, is_dated = block, None, "device_time_ns" in block and "segment" in block
        if is_dated:
            kept, shift = self._clock.evaluate(block["device_time_ns"], block["segment"])
            timely = block.with_columns({"segment": block["segment"] + shift})
            if not kept.all():
                rows = kept
                self._left_out["rows whose time does not go on"] += int((~kept).sum())
                timely = timely.kept(kept)
        columns = dict(timely.columns)
        for name, values in timely.columns.items():
            limits = (one for start, one in self._limits.items() if name.startswith(start))
            if values.dtype == np.float64 and (limit := next(limits, None)) is not None:
                low, high, label = limit
                self._leave_out((name,), (values < low) | (values > high), f"{name} {label}", columns)
        # What cannot be is no reading: it neither begins a sensor nor ends its standing still.
        for sensor, names in _sensors(columns):
            readings = np.stack([columns[name] for name in names])
            if sensor == "accel":  # one that is off reads zero; of a unit that falls, noise is left
                zero = (readings == 0.0).all(axis=0)
                self._leave_out(names, zero, "accel that is zero in all axes", columns)
            if sensor in self._still:
                why = f"{sensor} while its axes stand still where none can at rest"
                self._leave_out(names, self._still[sensor].evaluate(readings), why, columns)
            if sensor != "accel" and sensor not in self._begun:
                silent, why = self._begin(sensor, readings)
                self._leave_out(names, silent, why, columns)
        taken = SampleBlock(columns)
        if is_dated:
            for unchanged in self._unchanged:
                unchanged.process(timely)
            self._force.look(taken)
        return Taken(taken, rows)

    def notices(self, ended: bool = False) -> list[str]:
        """Return, once each, what is left out, at the end with how many, and what seems wrong otherwise."""
        every = {
            what: f"left out of all estimates: {what}" + (f" ({count:,} in all)" if ended else "")
            for what, count in self._left_out.items()
        }
        every |= {text: text for unchanged in self._unchanged for text in unchanged.found.values()}
        if (doubt := self._force.doubt(LEAST_S if ended else LONG_S)) is not None:
            every["force"] = doubt
        new = [text for what, text in every.items() if what not in self._reported]
        self._reported.update(every)
        return new

    def _leave_out(
        self, names: tuple[str, ...], rows: BoolArray, why: str, columns: dict[str, ColumnArray]
    ) -> None:
        if rows.any():
            self._left_out[why] += int(rows.sum())
            for name in names:
                columns[name] = np.where(rows, np.nan, columns[name])

    def _begin(self, sensor: str, readings: FloatArray) -> tuple[BoolArray, str]:
        """Return which readings come before a sensor has begun, and why they are none.

        These are the zeros of a sensor that is silent yet, and a gyro's repeated first reading: gyros that
        are stuck since the start look like those whose noise is below their step, and the bias of neither is
        known.  A thermometer may rightly stay on one level for hours.
        """
        there = np.asarray(~np.isnan(readings).any(axis=0))
        valid = np.any((readings != 0.0) & ~np.isnan(readings), axis=0)
        silent, what = there.copy(), "nothing but zero"
        if sensor == "gyro" and there.any():
            if self._first is None:
                self._first = readings[:, np.argmax(there)]
                silent[np.argmax(there)] = not self._first.any()  # the first is no repetition
            what = "nothing but its first reading" if self._first.any() else what
            valid &= there & np.any(readings != self._first[:, None], axis=0)
        if valid.any():
            self._begun.add(sensor)
        return silent & ~np.maximum.accumulate(valid), f"{sensor} while its values are {what}"


def _sensors(columns: Columns) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield gyros, accelerometers and each thermometer that is there, with its columns."""
    for sensor in IMPOSSIBLE_AT_REST:
        names = tuple(f"{sensor}_{axis}" for axis in "xyz")
        if all(name in columns for name in names):
            yield sensor, names
    yield from ((name, (name,)) for name in columns if name.startswith("temperature"))


class _Still:
    """Finds readings at which a sensor cannot be at rest, and which it repeats more often than it did before.

    `least`, `most`: of the largest axis at rest, as `IMPOSSIBLE_AT_REST`.
    """

    def __init__(self, least: float, most: float) -> None:
        self._least, self._most = least, most
        self._last = np.full(3, np.nan)
        self._run = self._longest = 0
        """Repetitions of the last reading, and the most of a reading that can be at rest."""

    def evaluate(self, readings: FloatArray) -> BoolArray:
        """Return which of the readings, (3, n), are repeated too often, (n,)."""
        n = readings.shape[1]
        if not n:
            return np.zeros(0, np.bool_)
        before = np.column_stack([self._last, readings[:, :-1]])
        same = (readings == before).all(axis=0)
        place = np.arange(n)
        run = place - np.maximum.accumulate(np.where(same, -1 - self._run, place))
        length = np.abs(before).max(axis=0)
        was_possible = (length == 0.0) | ((length >= self._least) & (length <= self._most))
        ended = np.where(~same & was_possible, np.append(self._run, run[:-1]), 0)
        longest = np.maximum.accumulate(np.maximum(ended, self._longest))
        self._last, self._run, self._longest = readings[:, -1].copy(), int(run[-1]), int(longest[-1])
        # While a reading is repeated it is the one before.
        return np.asarray(same & ~was_possible & (run > 2 * longest + REPEATS))


class _Unchanged:
    """Finds axes of a sensor that stay the same, or missing, in a window while another axis changes.

    A dead axis cannot be distinguished from one whose noise is below its step.  Where all axes stay as
    they are, as those of a coarse sensor at rest do, or switch between two levels, nothing is reported.
    """

    def __init__(self, sensor: str) -> None:
        self._sensor = sensor
        self._windows = SlotGatherer(3, UNCHANGED_NS)
        self.found: dict[str, str] = {}  # warning by axis

    def process(self, sent: SampleBlock) -> None:
        """Take the rows in which any axis has a reading."""
        if (values := sent.vector(self._sensor)) is None:
            return
        there = ~np.isnan(values).all(axis=1)
        ended = self._windows.process(sent["device_time_ns"][there], sent["segment"][there], values[there])
        for row in range(len(ended)):
            self._evaluate(ended, row)

    def _evaluate(self, windows: Slots, row: int) -> None:
        start_ns, changes = windows.start_ns[row], windows.changes[row].tolist()
        frequent = AT_AN_EDGE * windows.samples[row] + BEYOND_CHANCE * windows.samples[row] ** 0.5
        if windows.end_ns[row] - start_ns < 0.95 * UNCHANGED_NS or max(changes) <= frequent:
            return
        names, unit = [f"{self._sensor}_{axis}" for axis in "xyz"], RANGES[f"{self._sensor}_"][2]
        since = f"for {UNCHANGED_NS * 1e-9:g} s and more, since {start_ns * 1e-9:.3f} s of device time"
        beside = f"{since}, while {names[np.argmax(changes)]} changes"
        for name, value, changed in zip(names, windows.last[row].tolist(), changes, strict=True):
            text = f"reads {value:g} {unit} without any change {beside}: it is stuck, or too coarse"
            if np.isnan(value):
                text = f"reads nothing {beside}: it is dead"
            if not changed:
                self.found.setdefault(name, f"{name} {text}")


class _Clock:
    """Tests the time of each row by that of the last row that was taken."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        """Time and segment of the last row taken."""
        self._rejected, self._rejected_ns = 0, 0
        """How many rows in a row were left out and go on from each other, and the time of the last."""
        self._shift = 0
        """Segments that were begun here."""

    def evaluate(self, time_ns: IntArray, segment: IntArray) -> tuple[BoolArray, IntArray]:
        """Return which rows are taken, (n,), and what to add to their segment, (n,)."""
        n = len(time_ns)
        taken, shift = np.ones(n, np.bool_), np.full(n, self._shift)
        # A table of others may have floats.
        is_dated = (time_ns != NO_INT) & np.isfinite(time_ns) & np.isfinite(segment)
        before_ns, before = self._last or (0, 0)
        step_ns = np.diff(time_ns.astype(np.float64), prepend=before_ns)
        goes_on = (step_ns > 0.0) & (step_ns <= LONGEST_GAP_S * 1e9)
        goes_on |= np.diff(segment, prepend=before) != 0
        if n and self._last is not None and np.all(goes_on & is_dated):
            self._last, self._rejected = (int(time_ns[-1]), int(segment[-1])), 0
            return taken, shift
        for row, (time, part) in enumerate(zip(time_ns.tolist(), segment.tolist(), strict=True)):
            taken[row] = is_dated[row] and self._take(time, part)
            shift[row] = self._shift
        return taken, shift

    def _take(self, time_ns: int, segment: int) -> bool:
        last = self._last
        if last is not None and segment == last[1] and not 0 < time_ns - last[0] <= LONGEST_GAP_S * 1e9:
            goes_on = 0 < time_ns - self._rejected_ns <= LONGEST_GAP_S * 1e9
            self._rejected = self._rejected + 1 if goes_on else 1
            self._rejected_ns = time_ns
            if self._rejected < STUBBORN:
                return False
            self._shift += 1
        self._last, self._rejected = (time_ns, segment), 0
        return True


def rate_doubts(rate_hz: float) -> list[str]:
    """Return the warning for a rate of samples, Hz, that no sensor has; none for NaN."""
    what = f"the rows come at {rate_hz:.3g} Hz, as those of no inertial sensor"
    return [f"{what}: is the unit of the time right?"] if rate_hz < SLOWEST_HZ or rate_hz > FASTEST_HZ else []


class SpecificForce:
    """Tests the magnitude of the specific force of all samples, whatever the division into blocks."""

    def __init__(self) -> None:
        self._beyond = self._readings = 0  # readings beyond `GRAVITIES`, and all
        self._sum, self._span_ns = 0.0, 0  # sum of all, in g, and the time in which they came, without gaps
        self._last_ns = np.zeros(0, np.int64)

    def look(self, block: SampleBlock) -> None:
        """Take samples, with what is left out of them missing."""
        if (accel := block.accel) is None:
            return
        with np.errstate(over="ignore"):
            force = np.sqrt(np.einsum("ij,ij->i", accel, accel)) / STANDARD_GRAVITY
            there = ~np.isnan(force)
            self._sum += force[there].sum()
        self._readings += int(there.sum())
        self._beyond += int(((force < GRAVITIES[0]) | (force > GRAVITIES[1])).sum())
        if "device_time_ns" in block:
            time_ns = np.append(self._last_ns, block["device_time_ns"][there])
            self._span_ns += int(np.clip(np.diff(time_ns), 0, 10**9).sum())
            self._last_ns = time_ns[-1:]

    def through(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Take samples on their way, without their times, which a table of others may lack."""
        for block in blocks:
            self.look(SampleBlock({name: block[name] for name in block.columns if name.startswith("accel_")}))
            yield block

    def doubt(self, least_s: float = 0.0) -> str | None:
        """Return the warning where most readings are of no motion and span so many seconds."""
        beyond, n = self._beyond, self._readings
        if n < LEAST_READINGS or beyond <= BEYOND * n or self._span_ns < 1e9 * least_s:
            return None
        return (
            f"{beyond / n:.0%} of the specific force readings are not within {GRAVITIES[0]:g} to"
            f" {GRAVITIES[1]:g} times gravity but {self._sum / n:.2g} in the mean: are byte order, scale and"
            " unit right in the device file or map?  Else it fell or spun"
        )
