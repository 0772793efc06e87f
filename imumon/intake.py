"""What no estimate may be made from: values no sensor has, saturated sensors, times that do not go on.

Stages see such a value as missing and such a row not at all; tables keep both as they were sent.  So a fault
is kept out at one place, whatever a stage would make of it, and its end is the end of what is left out.  An
axis that says the same for long while another does not is told, and a specific force that cannot be in the
unit that was declared.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.magnitudes import SpecificForce
from imumon.protocols.ranges import Ranges

RANGES: dict[str, tuple[float, float, str]] = {
    "gyro_": (-1e3, 1e3, "rad/s"),
    "accel_": (-1e6, 1e6, "m/s^2"),
    "mag_": (-1e9, 1e9, ""),
    "temperature": (-100.0, 250.0, "°C"),
    "pressure": (0.0, 1e10, "Pa"),
    "q_": (-2.0, 2.0, ""),
}
"""By the beginning of a column's name, what a sensor may say: three times the widest range that is sold.

50,000 °/s, 100,000 g; 32-bit counts of a magnetometer without unit; 1 GPa; a quaternion that was not
normalised.  Of a thermometer, where no semiconductor sensor works.
"""
LONGEST_GAP_S = 1e6
"""Within a segment, eleven days: a clock that leaps so far did not count."""
STUBBORN = 100
"""Rows in a row that go on from another time: then the clock was set, and a segment of its own begins."""
IMPOSSIBLE_AT_REST = {"gyro": (0.0, 2.0), "accel": (1.0, 30.0)}
"""What the largest axis says at rest, at least and at most, rad/s and m/s^2: 115 °/s of bias, 3 g.

A sensor whose noise is below its step stands still at rest, rightly; beyond this it is saturated or dead.
"""
BY_CHANCE = 1e-9
"""Probability at which repeated readings are no chance: a day at 4 kHz has 3.5e8 samples."""
UNCHANGED_S = 30.0
"""An axis that says the same for so long beside one that does not is told: no hand turns a unit about one
axis for so long and keeps the others within a step."""
AT_AN_EDGE, BEYOND_CHANCE = 0.5, 6.0
"""Noise below a step changes at most this share of an axis' readings, where it is between two steps, while
the axes beside it may rightly stay on one; more by so many standard deviations is no chance, `BY_CHANCE`."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What the stages see of a block."""

    block: SampleBlock
    """Its rows that are taken, values that are not left out."""
    rows: BoolArray | None
    """Which rows of the block these are; None for all."""

    def spread(self, column: ColumnArray) -> ColumnArray:
        """Return a column of the rows that were taken as one of all rows, missing in between."""
        if self.rows is None:
            return column
        none = np.nan if column.dtype == np.float64 else np.iinfo(np.int64).min
        whole = np.full(len(self.rows), none, column.dtype)
        whole[self.rows] = column
        return whole


class Intake:
    """Keeps out of the stages what no estimate may be made from, and counts it.

    The result does not depend on the division into blocks.

    Parameters
    ----------
    ranges : Ranges
        What is declared: from there on a reading is the end of the range, and nobody knows what it was.
    """

    def __init__(self, ranges: Ranges | None = None) -> None:
        self._limits = {} if ranges is None else ranges.limits()
        """By the beginning of a column's name: what is inside, and what is said of the rest."""
        for start, (low, high, unit) in RANGES.items():
            self._limits[start] = low, high, f"beyond {low:g} to {high:g} {unit}".rstrip()
        self._clock = _Clock()
        self._still = {sensor: _Still() for sensor in IMPOSSIBLE_AT_REST}
        self._unchanged = {sensor: _Unchanged(sensor) for sensor in IMPOSSIBLE_AT_REST}
        self._begun: set[str] = set()
        """Gyros and thermometers that have said something: not only zero, nor gyros their first reading."""
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
        taken, rows = self._timely(block)
        changed: dict[str, ColumnArray] = {}
        for name, values in taken.columns.items():
            limits = self._limits_of(name) if values.dtype == np.float64 else None
            if limits is not None and (sound := self._sound(name, values, limits)) is not None:
                changed[name] = sound
        # What cannot be is no reading: it neither begins a sensor nor ends its standing still.
        possible = taken.with_columns(changed) if changed else taken
        for sensor, still in self._still.items():
            axes = tuple(f"{sensor}_{axis}" for axis in "xyz")
            if all(name in taken for name in axes):
                self._stand_still(axes, still, possible, changed)
        for name in taken.columns:
            if name.startswith("temperature") and name not in self._begun:
                self._begin(name, (name,), possible, changed)
        gyros = tuple(f"gyro_{axis}" for axis in "xyz")
        if "gyro" not in self._begun and all(name in taken for name in gyros):
            self._begin("gyro", gyros, possible, changed)
        if "device_time_ns" in taken and "segment" in taken:
            for unchanged in self._unchanged.values():
                unchanged.process(taken)
        taken = taken.with_columns(changed) if changed else taken
        if "segment" in taken:
            self._force.look(taken)
        return Taken(taken, rows)

    def _timely(self, block: SampleBlock) -> tuple[SampleBlock, BoolArray | None]:
        """Return the rows whose time goes on, and which these are; None for all."""
        if "device_time_ns" not in block or "segment" not in block:
            return block, None
        rows, shift = self._clock.evaluate(block["device_time_ns"], block["segment"])
        taken = block if shift is None else block.with_columns({"segment": block["segment"] + shift})
        if rows is None:
            return taken, None
        self._left_out["rows whose time does not go on"] += int((~rows).sum())
        return SampleBlock({name: values[rows] for name, values in taken.columns.items()}), rows

    def notices(self, ended: bool = False) -> list[str]:
        """Return, once each, what is left out, at the end with how many, and what seems wrong otherwise."""
        every = {
            what: f"left out of all estimates: {what}" + (f" ({count:,} in all)" if ended else "")
            for what, count in self._left_out.items()
        }
        every |= {text: text for unchanged in self._unchanged.values() for text in unchanged.found.values()}
        if self._force.found is not None:
            every[self._force.found] = self._force.found
        new = [text for what, text in every.items() if what not in self._reported]
        self._reported.update(every)
        return new

    def _limits_of(self, name: str) -> tuple[float, float, str] | None:
        return next((limits for start, limits in self._limits.items() if name.startswith(start)), None)

    def _sound(self, name: str, values: FloatArray, limits: tuple[float, float, str]) -> FloatArray | None:
        """Return the values with NaN where none can be, or None when all can."""
        low, high, label = limits
        if not len(values) or (low <= values.min() and values.max() <= high):  # not so where one is NaN
            return None
        bad = ~((values >= low) & (values <= high)) & ~np.isnan(values)
        count = int(bad.sum())
        if not count:
            return None
        self._left_out[f"{name} {label}"] += count
        return np.where(bad, np.nan, values)

    def _stand_still(
        self, sensor: tuple[str, ...], still: _Still, block: SampleBlock, changed: dict[str, ColumnArray]
    ) -> None:
        """Leave out what all axes of a sensor repeat more often than by chance."""
        name = sensor[0].removesuffix("_x")
        readings = np.stack([block[axis] for axis in sensor])
        if name == "accel":  # one that is off says zero; of a unit that falls, noise is left
            self._leave_out(
                sensor, (readings == 0.0).all(axis=0), f"{name} that is zero in all axes", block, changed
            )
        stands = still.evaluate(readings)
        if stands is None:
            return
        length = np.abs(readings).max(axis=0)
        least, most = IMPOSSIBLE_AT_REST[name]
        stands &= ((length > 0.0) & (length < least)) | (length > most)
        why = f"{name} while its axes stand still where none can at rest"
        self._leave_out(sensor, stands, why, block, changed)

    def _leave_out(
        self, columns: tuple[str, ...], rows: BoolArray, why: str, block: SampleBlock,
        changed: dict[str, ColumnArray],
    ) -> None:  # fmt: skip
        """Take rows of a sensor for missing, and count them."""
        count = int(rows.sum())
        if not count:
            return
        for name in columns:
            changed[name] = np.where(rows, np.nan, changed.get(name, block[name]))
        self._left_out[why] += count

    def _begin(
        self, sensor: str, columns: tuple[str, ...], block: SampleBlock, changed: dict[str, ColumnArray]
    ) -> None:
        """Leave out the zeros of a sensor that has said nothing yet, and a gyro's repeated first reading.

        Nobody can tell gyros that are stuck since the start from those whose noise is below their step; the
        bias of neither is known.  A thermometer may rightly stay on one level for hours.
        """
        readings = np.stack([block[name] for name in columns])
        there = ~np.isnan(readings).any(axis=0)
        valid = np.any((readings != 0.0) & ~np.isnan(readings), axis=0)
        silent, why = there.copy(), "nothing but zero"
        if sensor == "gyro" and there.any():
            if self._first is None:
                self._first = readings[:, np.argmax(there)]
                silent[np.argmax(there)] = not self._first.any()  # the first is no repetition
            why = "nothing but its first reading" if self._first.any() else why
            valid &= there & np.any(readings != self._first[:, np.newaxis], axis=0)
        begun = np.maximum.accumulate(valid)
        if begun[-1:].any():
            self._begun.add(sensor)
        self._leave_out(columns, silent & ~begun, f"{sensor} while its values are {why}", block, changed)


class _Still:
    """Tells a sensor that stands still from one that happens to say the same again.

    How often it does so is learned from what came before; a sensor with coarse steps, or that is read more
    often than it measures, repeats itself.  Then n repetitions by chance have the probability p^n.
    """

    def __init__(self) -> None:
        self._last = np.full(3, np.nan)
        self._run = 0
        """Readings before this one that are the same as the last."""
        self._allowed = -1
        """How often they may be, as it was when they began; -1 when that has not been looked up."""
        self._pairs = self._repeats = 0

    def evaluate(self, readings: FloatArray) -> BoolArray | None:
        """Return where readings, (3, n), stand still, or None when none does."""
        n = readings.shape[1]
        if not n:
            return None
        same = np.empty(n, np.bool_)
        same[0] = np.array_equal(readings[:, 0], self._last)
        np.equal(readings[0, 1:], readings[0, :-1], out=same[1:])
        if same[1:].any():
            same[1:] &= (readings[1:, 1:] == readings[1:, :-1]).all(axis=0)
        self._last = readings[:, -1].copy()
        if not same.any():
            self._pairs, self._run, self._allowed = self._pairs + n, 0, -1
            return None
        begins = np.flatnonzero(~same)
        pairs = self._pairs + np.arange(n)
        repeats = self._repeats + np.concatenate([[0], np.cumsum(same)[:-1]])
        allowed = _allowed(pairs[begins], repeats[begins])
        if not begins.size or begins[0] > 0:  # a run goes on from the block before
            begins, allowed = np.concatenate([[0], begins]), np.concatenate([[self._carried()], allowed])
            before = self._run + 1
        else:
            before = 0
        lengths = np.diff(np.append(begins, n))
        count = np.arange(n) - np.repeat(begins, lengths)
        count[: lengths[0]] += before
        stands = count > np.repeat(allowed, lengths)
        self._run, self._allowed = int(count[-1]), int(allowed[-1])
        self._pairs, self._repeats = self._pairs + n, self._repeats + int(same.sum())
        return stands if stands.any() else None

    def _carried(self) -> int:
        if self._allowed >= 0:
            return self._allowed
        return int(_allowed(np.array([self._pairs - 1]), np.array([self._repeats]))[0])


def _allowed(pairs: IntArray, repeats: IntArray) -> IntArray:
    """Return how many repetitions may be chance, by Laplace's rule of succession."""
    chance = (repeats + 1.0) / (pairs + 2.0)
    allowed = np.ceil(np.log(BY_CHANCE) / np.log(chance)).astype(np.int64)
    return np.where(pairs == repeats, 0, allowed)  # it has not said anything else yet


class _Unchanged:
    """Finds axes of a sensor that stay the same, or missing, while another axis changes.

    Tested in windows of `UNCHANGED_S` of device time, which begin anew with each segment.  Whether such an
    axis is dead, nobody can tell of one whose noise is below its step.  Where all axes stay as they are, as
    those of a coarse sensor at rest do, or go to and fro between two levels, nothing is reported.
    """

    def __init__(self, sensor: str) -> None:
        self._names = tuple(f"{sensor}_{axis}" for axis in "xyz")
        self._unit = RANGES[f"{sensor}_"][2]
        self.found: dict[str, str] = {}
        """Warning by axis."""
        self._last = np.full(3, np.nan)
        self._segment, self._began_ns = NO_INT, 0
        self._readings, self._changes = 0, np.zeros(3, np.int64)
        """In the window so far: readings, and how many of each axis differ from the one before."""

    def process(self, sent: SampleBlock) -> None:
        """Take the rows in which any axis has a reading."""
        if not all(name in sent for name in self._names):
            return
        readings = np.stack([sent[name] for name in self._names])
        there = ~np.isnan(readings).all(axis=0)
        if not there.any():
            return
        readings, time_ns = readings[:, there], sent["device_time_ns"][there]
        segment = sent["segment"][there]
        first = readings[:, :1] if self._segment == NO_INT else self._last[:, np.newaxis]
        before = np.hstack([first, readings[:, :-1]])
        changed = (readings != before) & ~(np.isnan(readings) & np.isnan(before))
        at, n = 0, len(time_ns)
        while at < n:
            part = int(segment[at])
            if part != self._segment:
                self._segment = part
                self._begin(int(time_ns[at]))
            rest = at + int(np.argmin(np.append(segment[at:] == part, False)))
            window_end_ns = self._began_ns + round(UNCHANGED_S * 1e9)
            stop = at + int(np.searchsorted(time_ns[at:rest], window_end_ns))
            self._readings += stop - at
            self._changes += changed[:, at:stop].sum(axis=1)
            if stop < rest:
                self._evaluate(readings[:, stop - 1] if stop else self._last)
                self._begin(int(time_ns[stop]))
            at = stop
        self._last = readings[:, -1].copy()

    def _begin(self, time_ns: int) -> None:
        self._began_ns, self._readings, self._changes = time_ns, 0, np.zeros(3, np.int64)

    def _evaluate(self, values: FloatArray) -> None:
        """Report the axes that did not change in a window; `values` are the last readings."""
        sd = (AT_AN_EDGE * (1.0 - AT_AN_EDGE) * self._readings) ** 0.5
        lively = int(self._changes.argmax())
        if self._changes[lively] <= AT_AN_EDGE * self._readings + BEYOND_CHANCE * sd:
            return
        since = f"for {UNCHANGED_S:g} s and more, since {self._began_ns * 1e-9:.3f} s of device time"
        for axis in np.flatnonzero(self._changes == 0):
            name = self._names[axis]
            what, why = f"{name} says nothing", "it is dead"
            if not np.isnan(values[axis]):
                what = f"{name} says {values[axis]:g} {self._unit} without any change"
                why = "it is stuck, or its noise is below its steps"
            self.found.setdefault(name, f"{what} {since}, while {self._names[lively]} changes: {why}")


class _Clock:
    """Judges the time of each row by that of the last row that was taken."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        """Time and segment of the last row taken."""
        self._rejected: list[int] = [0, 0]
        """How many rows in a row were left out and go on from each other, and the time of the last."""
        self._shift = 0
        """Segments that were begun here."""

    def evaluate(self, time_ns: IntArray, segment: IntArray) -> tuple[BoolArray | None, IntArray | None]:
        """Return which rows are taken, None for all, and what to add to their segment, None for nothing."""
        if not len(time_ns):
            return None, None
        if self._last is not None and self._is_plain(time_ns, segment):
            self._last, self._rejected = (int(time_ns[-1]), int(segment[-1])), [0, 0]
            return None, np.full(len(time_ns), self._shift) if self._shift else None
        taken, shift = np.empty(len(time_ns), np.bool_), np.empty(len(time_ns), np.int64)
        for row, (time, part) in enumerate(zip(time_ns.tolist(), segment.tolist(), strict=True)):
            taken[row] = self._take(time, part)
            shift[row] = self._shift
        return None if taken.all() else taken, shift if self._shift else None

    def _is_plain(self, time_ns: IntArray, segment: IntArray) -> bool:
        assert self._last is not None
        before = np.concatenate([[self._last[0]], time_ns[:-1]])
        same = segment == np.concatenate([[self._last[1]], segment[:-1]])
        step = time_ns.astype(np.float64) - before
        return bool(np.all(~same | ((time_ns > before) & (step <= LONGEST_GAP_S * 1e9))))

    def _take(self, time_ns: int, segment: int) -> bool:
        last = self._last
        if last is not None and segment == last[1] and not 0 < time_ns - last[0] <= LONGEST_GAP_S * 1e9:
            count, before = self._rejected
            goes_on = count and 0 < time_ns - before <= LONGEST_GAP_S * 1e9
            self._rejected = [count + 1 if goes_on else 1, time_ns]
            if self._rejected[0] < STUBBORN:
                return False
            self._shift += 1
        self._last, self._rejected = (time_ns, segment), [0, 0]
        return True
