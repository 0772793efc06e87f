"""From samples to the slots that the filter takes: half seconds, at rest or not, and the turns in them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import NO_INT, BoolArray, FloatArray, IntArray
from imumon.estimation.gyro_bias.slot import Slot
from imumon.estimation.gyro_bias.thermal_input import ThermalVariance, unseen_lag
from imumon.filters.slots import SlotGatherer, Slots
from imumon.filters.turns import STILL

SLOT_S = 0.5
GAP_S = 0.25
"""A pause between samples is a gap when it is longer than this and than three usual intervals."""
LEAST_COVERED = 0.5
"""Share of a slot that must have samples, else there is a gap in it."""
# Columns of the gatherer.
AT_REST_RATE, AT_REST_FORCE, RATE, FORCE, DEGC, INITIAL_SD, TURN = (slice(3 * i, 3 * i + 3) for i in range(7))
REST, COLUMNS = 21, 22


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of a block.

    Parameters
    ----------
    time_ns, segment : array of int64 (n,)
    gyro : array (n, 3)
        Less what the thermal model has added, rad/s.
    accel : array (n, 3)
        m/s²; NaN where there is none.
    degc, initial_sd : array (n, 3)
        Temperature, and standard deviation of the thermal model for want of knowledge of its state, rad/s.
    rate_sd : array (n, 3)
        Standard deviation of the rate of temperature, °C/s; NaN where there is none.
    turn : array (n, 3)
        A turn that may be a change of the bias, rad/s; 0 where there is none.
    rest : array of bool (n,)
    """

    time_ns: IntArray
    segment: IntArray
    gyro: FloatArray
    accel: FloatArray
    degc: FloatArray
    initial_sd: FloatArray
    rate_sd: FloatArray
    turn: FloatArray
    rest: BoolArray


@dataclass(slots=True, eq=False)
class _Before:
    """The slot before: end, its interval and the shortest of any, s; whether it was at rest at its end, what
    was undecided there, and at the end of the last rest; origin of time."""

    origin_ns: int = 0
    end_s: float = 0.0
    interval_s: float = 0.0
    shortest_s: float = math.inf
    rest: bool = False
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    resting: FloatArray = field(default_factory=lambda: np.full(3, np.inf))

    @property
    def longest_s(self) -> float:
        """A longer pause between samples is a gap."""
        return max(GAP_S, 3.0 * self.interval_s)


def complete(vectors: FloatArray) -> BoolArray:
    """Return whether all three components are there, (n,)."""
    x, y, z = vectors.T
    return np.asarray(np.isfinite(x) & np.isfinite(y) & np.isfinite(z))


class Intake:
    """Gathers samples; the same slots whatever the division into blocks."""

    def __init__(self, thermal: ThermalVariance) -> None:
        self._gatherer = SlotGatherer(COLUMNS, round(SLOT_S * 1e9), rates=RATE.start)
        self._thermal = thermal
        self._values = np.empty((0, COLUMNS))
        self._before = _Before()

    def process(self, samples: Samples) -> Iterator[tuple[int, bool, Slot | None]]:
        """Yield the row behind each slot, whether a segment begins with it, and what it says, if anything."""
        time_ns = np.where(complete(samples.gyro), samples.time_ns, NO_INT)
        force = np.where(complete(samples.accel)[:, np.newaxis], samples.accel, np.nan)
        if len(self._values) < len(time_ns):
            self._values = np.empty((len(time_ns), COLUMNS))
        values = self._values[: len(time_ns)]
        rest = samples.rest[:, np.newaxis]
        values[:, AT_REST_RATE] = np.where(rest, samples.gyro, np.nan)
        values[:, AT_REST_FORCE] = np.where(rest, force, np.nan)
        values[:, RATE], values[:, FORCE] = samples.gyro, force
        values[:, DEGC], values[:, INITIAL_SD] = samples.degc, samples.initial_sd
        values[:, TURN], values[:, REST] = samples.turn, samples.rest
        slots = self._gatherer.process(time_ns, samples.segment, values)
        for k in range(len(slots)):
            row = int(slots.row[k])
            yield row, bool(slots.begins[k]), self._slot(slots, k)
            if int(samples.segment[row]) == int(slots.segment[k]):
                gap = self._gap(samples, row)
                if gap is not None:
                    yield row, False, gap

    def _gap(self, samples: Samples, row: int) -> Slot | None:
        """Return the slot that nobody saw, if the sample behind a slot comes after a gap."""
        before, degc = self._before, samples.degc[row]
        behind = (int(samples.time_ns[row]) - before.origin_ns) * 1e-9
        if before.interval_s == 0.0 or behind - before.end_s <= before.longest_s:
            return None
        end = behind - before.interval_s
        start, before.end_s, before.rest = before.end_s, end, False
        lag_degc = unseen_lag(end - start, samples.rate_sd[row])
        self._thermal.miss(lag_degc)
        return Slot(
            start,
            end,
            max(SLOT_S, before.interval_s),
            follows=False,
            rest=False,
            rate=np.full(3, np.nan),
            force=None,
            degc=degc,
            growth=self._thermal.step(degc, samples.initial_sd[row]),
            lag_degc=lag_degc,
            undecided=before.turn,
            turn=STILL,
            gap=True,
        )

    def _slot(self, slots: Slots, k: int) -> Slot | None:
        """Return what a slot says; None of a single sample before which nothing is known."""
        before, samples = self._before, int(slots.samples[k])
        if slots.begins[k]:
            before = self._before = _Before(origin_ns=int(slots.start_ns[k]))
            self._thermal.begin()
        start = (int(slots.start_ns[k]) - before.origin_ns) * 1e-9
        end = (int(slots.end_ns[k]) - before.origin_ns) * 1e-9
        inside = (end - start) / (samples - 1) if samples > 1 else 0.0
        pause = start - before.end_s
        gap = pause > before.longest_s or samples * before.interval_s < LEAST_COVERED * (end - before.end_s)
        if slots.begins[k] or gap:
            interval = inside if samples > 1 or slots.begins[k] else before.interval_s
            start -= interval
            gap = not slots.begins[k]
        else:
            start = before.end_s
        before.interval_s = (end - start) / samples if samples > 1 or not gap else pause
        if before.interval_s > 0.0:
            before.shortest_s = min(before.shortest_s, before.interval_s)
        before.end_s = end
        return self._said(slots, k, start, end, gap)

    def _said(self, slots: Slots, k: int, start: float, end: float, gap: bool) -> Slot | None:
        before, samples = self._before, int(slots.samples[k])
        covered = min(1.0, samples * before.shortest_s / (end - start)) if end > start else 0.0
        still = slots.smallest[k, REST] == 1.0
        arrives = slots.changes[k, REST] == 1 and slots.first[k, REST] == 0.0
        rest = bool(still or (arrives and slots.last[k, REST] == 1.0))
        follows = bool(before.rest and still and not gap)
        before.rest = bool(slots.last[k, REST] == 1.0) and rest
        # What had not been decided is a change of the bias when the unit is said to be at rest after all.
        first, last = slots.first[k, TURN], slots.last[k, TURN]
        undecided = (first if first.any() else before.turn) if rest else last
        if rest and not follows:
            # What was undecided in the last rest, and is, has not changed the bias since.
            same = np.minimum(np.abs(first), np.abs(before.resting))
            undecided = np.sqrt(np.maximum(undecided**2 - same**2, 0.0))
        before.turn = last
        before.resting = last if before.rest else before.resting
        degc = np.where(rest, slots.mean[k, DEGC], slots.last[k, DEGC])
        growth = self._thermal.step(slots.last[k, DEGC], slots.last[k, INITIAL_SD])
        rate, force, which = slots.mean[k, RATE], slots.mean[k, FORCE], FORCE
        if rest and not still:
            share = float(slots.count[k, AT_REST_RATE.start]) / samples
            start = end - share * (end - start)
            rate, force, which = slots.mean[k, AT_REST_RATE], slots.mean[k, AT_REST_FORCE], AT_REST_FORCE
        if end <= start:
            return None
        forced = bool(slots.count[k, which.start])
        return Slot(
            start,
            end,
            end - start,
            follows,
            rest,
            rate,
            force if forced else None,
            degc,
            growth,
            np.zeros(3),
            undecided,
            slots.turns.at(k),
            gap,
            covered,
        )
