"""Temperature and rate of one thermometer, slot by slot: the bank, faults, what is shown."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field
from typing import NamedTuple

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.estimation.temperature_rate.bank import (
    SLOT_S,
    START_ACCELERATION,
    UNSEEN_RATE,
    Bank,
    advance,
    started,
)
from imumon.estimation.temperature_rate.measurement import Merged, measure, merged, said
from imumon.estimation.temperature_rate.refresh import FASTEST, SLOW_S
from imumon.estimation.temperature_rate.sensor import Reading, Sensor
from imumon.estimation.temperature_rate.step import COARSEST, StepFinder

GLIDE_S = 3.0
"""Time constant with which what is shown follows the state, so that it does not jump."""
SURPRISING = 6.0
"""A change by so many standard deviations and half a step corrects an error: then the temperature jumps."""
ALLOWED = 2.5
"""The temperature is within half a step and so many standard deviations of the noise of the readings, ..."""
SLOW_ALLOWED = 0.5
"""... of their slow error so many: the nearer, the less is a ramp missed that begins in it."""
STEP_CHANGE = 0.25
"""A step found to be so much larger is another."""
GATE, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A reading off by so many deviations and steps, and by more than a temperature moves, is a fault; after so
many slots it is the truth, unless it has not changed since: that is a thermometer that sticks."""
GAP_S = 600.0
"""After so long without a reading, or of a sensor that is dead or sticks, there is no estimate; a later
reading begins anew."""
LATE_S, LATE_FACTOR = 5.0, 3.0
"""Readings missed for so long, and so many times the usual interval, ..."""
UNSEEN_JERK = 1e-13
"""... let the temperature do this, °C²/s⁵, that nobody saw."""
UNAVERAGED = 0.5
"""The mean of a slow error is known to so many of its deviations: below its correlation time it is 1/f."""
FROZEN_S, DRIFT_PER_S = 3600.0, 1.0 / 3600.0**2
"""A level unchanged for an hour is trusted less: the band grows by 1 °C/h every hour, up to the start's."""

BROKEN = 5.0
"""A rate that changes by so many of its standard deviations within a slot contradicts the slot before."""
MOST_BROKEN, BROKEN_S = 12.0, 600.0
"""So many contradictions, each forgotten over this time, and no model is right: measured (kinds of
`scripts/reproduce/thermometers`), the begin of a ramp makes 0 to 3, of a ramp in steps of 0.001 °C 6, a
thermostat that switches every 2 min keeps it at 5 to 7, popcorn noise at 25 to 33."""


class Shown(NamedTuple):
    """What is shown from a time on: a parabola, and remainders of what was shown before that fade away."""

    time_s: float = 0.0
    temperature: float = math.nan
    rate: float = math.nan
    acceleration: float = math.nan
    """°C, °C/s, °C/s²."""
    temperature_sd: float = math.nan
    rate_sd: float = math.nan
    temperature_left: float = 0.0
    rate_left: float = 0.0
    """The remainders at `time_s`."""
    reach: float = math.inf
    """No sample is shown farther from the readings beside it than this, °C."""
    lively: bool = True
    """Whether readings have changed, so that a fault shows as one."""


@dataclass(slots=True, eq=False)
class State:
    """All that is known of one thermometer and its temperature."""

    sensor: Sensor
    bank: Bank | None = None
    """None without an estimate."""
    shown: Shown = field(default_factory=Shown)
    time_s: float = 0.0
    end_s: float = 0.0
    """What the bank refers to, and the end of the last slot."""
    last: float = math.nan
    last_s: float = -math.inf
    """Last reading and the middle of its slot; a slot's mean before."""
    usual_s: float = 0.0
    """Time between the last two slots with readings."""
    slowest: float = 0.0
    fastest: float = 0.0
    """Rates that the last two readings show and allow until the next, °C/s; for slow refreshes."""
    step: float = 0.0
    """The step that the bank takes the readings to have, °C."""
    faults: int = 0
    """Slots that were passed over in a row."""
    stuck: float = math.nan
    stuck_s: float = math.nan
    """What the first of them ended with, °C, NaN once that has changed; and when that was."""
    stuck_at: float = math.nan
    """Where it stuck last, °C; NaN if it never did."""
    lively: bool = False
    """Whether readings have changed in this segment."""
    broken: float = 0.0
    """Contradictions of late: sudden changes of the rate that its standard deviation did not allow."""
    refuses: bool = False
    """Whether there are too many for an estimate: then the readings themselves are given."""
    given: Shown = field(default_factory=Shown)
    """What is given to the user: what is shown, or the readings."""

    @classmethod
    def new(cls, step_degc: float | None) -> State:
        """Return the state before the first reading."""
        return cls(Sensor(StepFinder(step_degc)))

    @property
    def late_s(self) -> float:
        """How long after a slot that nothing follows nobody knows what the temperature has done."""
        return max(LATE_S, LATE_FACTOR * self.usual_s)

    def snapshot(self) -> State:
        """Return a copy."""
        return deepcopy(self)

    def repeats(self, reading: Reading) -> bool:
        """Tell whether the readings leapt as no temperature does, and are exactly the same since."""
        return self.faults > 0 and reading.low == reading.high == self.stuck

    def believes(self, reading: Reading) -> bool:
        """Tell whether a slot that no temperature explains is the truth all the same, and note it.

        Readings that go on changing are alive.  Of two levels that never changed the one that was there for
        longer is believed: what is first may be the value at power-on.
        """
        self.faults += 1
        if self.faults == 1:
            self.stuck, self.stuck_s = reading.last, reading.time_s
        elif not self.repeats(reading):
            # By what a temperature does and noise it moves; by a leap it sticks elsewhere.
            moved = max(abs(reading.low - self.stuck), abs(reading.high - self.stuck))
            if moved > self.sensor.moves(reading):
                self.faults, self.stuck, self.stuck_s = 1, reading.last, reading.time_s
            else:
                self.stuck = math.nan
        if math.isfinite(self.stuck):
            if self.faults == GATE_SLOTS:
                self.stuck_at = self.stuck
            return not self.lively and reading.time_s - self.stuck_s > self.stuck_s
        return self.faults >= GATE_SLOTS or self.sensor.refresh.slow

    def trusts(self) -> None:
        """Note a slot that a temperature explains."""
        self.faults, self.stuck = 0, math.nan

    def begin(self) -> None:
        """Begin anew, in a new segment; what is known of the sensor stays."""
        self.bank, self.shown, self.given = None, Shown(), Shown()
        self.faults, self.stuck, self.lively = 0, math.nan, False
        self.last, self.last_s = math.nan, -math.inf
        self.sensor.changed_s, self.sensor.means = math.nan, ()


def step(state: State, reading: Reading) -> Shown:
    """Take a slot; return what is given from its end on: the bank's estimate, or the readings."""
    before = state.shown
    shown = _estimate(state, reading)
    age = max(reading.end_s - before.time_s, 0.0)
    state.broken *= math.exp(-age / BROKEN_S) if before.time_s else 1.0
    change = shown.rate - before.rate - age * before.acceleration
    state.broken += bool(abs(change) > BROKEN * before.rate_sd)
    state.refuses = state.broken > (0.5 * MOST_BROKEN if state.refuses else MOST_BROKEN)
    if not state.refuses or state.bank is None:
        state.given = shown
    elif reading.count:
        state.given = _raw(state.sensor, reading, reading.mean - shown.temperature if state.faults else 0.0)
    return state.given


def _raw(sensor: Sensor, reading: Reading, off: float) -> Shown:
    """Return the mean of a slot's readings and how far they may be off; the rate is not known (NaN)."""
    sd = math.sqrt(sensor.step**2 + sensor.inside + sensor.roughness + reading.variance + off**2)
    return Shown(reading.end_s, reading.mean, 0.0, math.nan, sd, math.nan)


def _estimate(state: State, reading: Reading) -> Shown:
    """Take a slot; return what the bank shows from its end on."""
    sensor, knew = state.sensor, state.sensor.refresh.slow
    if reading.count:
        sensor.learn(reading)
        if not math.isfinite(sensor.changed_s):
            sensor.changed_s = reading.time_s
    taken = sensor.fresh(reading) if reading.count else None
    dead = sensor.is_dead(reading.time_s)
    heard = taken is not None and not dead
    repeats = reading.count > 0 and taken is None
    coarser = False
    if taken is not None and heard and sensor.refresh.slow and not knew:
        _begin_slow(state, reading.before, taken)
    elif state.bank is not None and sensor.step > (1.0 + STEP_CHANGE) * state.step > 0.0:
        # So far the readings were taken for finer than they are.
        state.bank = None
        coarser = True
    stuck = state.repeats(reading)
    seen_s = state.stuck_s if stuck else sensor.changed_s if dead else state.last_s
    if state.bank is not None and (stuck or not (heard or repeats)) and reading.end_s - seen_s > GAP_S:
        state.bank, state.shown = None, Shown()
    fresh, slow = state.bank is None, sensor.slow_errors
    if state.bank is None:
        if taken is None or dead or stuck or sensor.leaps(taken):
            return state.shown
        state.trusts()
        moved = (taken.last - state.last) / max(taken.time_s - state.last_s, 1.0) if coarser else 0.0
        state.bank = started((taken.mean, _start_sd(taken, sensor)), (0.0, abs(moved)), slow)
        state.step = sensor.step
        state.time_s, state.usual_s = taken.time_s, 0.0
    at = taken.time_s if taken is not None and heard else reading.end_s
    dt = max(at - state.time_s, 0.0)
    unseen = (not heard and not repeats) or dt > state.late_s or state.faults >= GATE_SLOTS
    predicted = advance(state.bank, dt, slow, UNSEEN_JERK if unseen else 0.0)
    state.time_s = max(at, state.time_s)
    if taken is not None and heard:
        known = state.bank
        state.bank = _heard(state, known, predicted, taken)
        fresh |= state.bank is not known
        if sensor.refresh.slow:
            moved, since = taken.last - state.last, 1.0 / max(at - state.last_s, 1.0)
            state.slowest = min(moved - sensor.unit, 0.0) * since
            state.fastest = max(moved + sensor.unit, 0.0) * since
        state.last, state.last_s = taken.last, taken.time_s
        state.usual_s = dt
    still = taken is not None and heard and not state.faults and not taken.changes and sensor.step > 0.0
    means = merged(
        state.bank.filters, slow, sensor.step, taken.last if taken is not None and still else math.nan
    )
    state.shown = _shown(state, means, reading.end_s, fresh)
    state.shown = state.shown._replace(lively=state.lively)
    other = state.stuck if math.isfinite(state.stuck) else reading.last
    if state.faults and not state.lively and math.isfinite(other):
        # Nobody knows which of two levels is the fault.
        sd = math.hypot(state.shown.temperature_sd, other - state.shown.temperature)
        state.shown = state.shown._replace(temperature_sd=sd)
    if (heard or repeats) and not state.faults:
        _keep_near(state, means.slow, reading if taken is None else taken, reading.end_s)
    return state.shown


def _begin_slow(state: State, before: float, taken: Reading) -> None:
    """Begin anew with a sensor found to be refreshed slowly: its repeats were taken for readings."""
    sensor = state.sensor
    state.last, state.last_s = before, taken.time_s - sensor.refresh.interval_s
    moved = (taken.last - before) / sensor.refresh.interval_s
    temperature = (taken.mean, _start_sd(taken, sensor))
    state.bank = started(temperature, (0.0, abs(moved)), sensor.slow_errors)
    state.time_s, state.step = taken.time_s, sensor.step
    state.trusts()


def _keep_near(state: State, slow: float, reading: Reading, end_s: float) -> None:
    """Keep what is shown as near to the readings as they allow (the idea of the paper's equation 15).

    A reading that is repeated until the next refresh allows what the temperature may move by its age.
    """
    sensor, shown = state.sensor, state.shown
    low, high = reading.low, reading.high
    if reading.changes >= 4:
        low = high = sensor.linear(reading) + (end_s - reading.time_s) * shown.rate
    slow *= (SLOW_ALLOWED / ALLOWED) ** 2
    allowed = 0.5 * sensor.step + ALLOWED * math.sqrt(sensor.roughness + slow)
    if not sensor.refresh.slow:
        reach = 0.5 * sensor.step + ALLOWED * math.sqrt(sensor.inside + sensor.roughness + slow)
        shown = state.shown = shown._replace(reach=reach)
    else:
        age = max(end_s - state.last_s, 0.0)
        low, high = low + state.slowest * age, high + state.fastest * age
    temperature = shown.temperature + shown.temperature_left
    off = temperature - min(max(temperature, low - allowed), high + allowed)
    if off:
        sd = math.hypot(shown.temperature_sd, off)
        state.shown = shown._replace(temperature=shown.temperature - off, temperature_sd=sd)


def _start_sd(reading: Reading, sensor: Sensor) -> float:
    return math.hypot(sensor.unit, math.sqrt(reading.variance))


def _heard(state: State, bank: Bank, predicted: tuple[float, float], reading: Reading) -> Bank:
    """Return the bank given readings, or as it was where they are a fault."""
    sensor = state.sensor
    mean, variance = predicted
    widest = variance + sensor.step**2 + sensor.inside + sensor.roughness
    possible = FASTEST * (reading.time_s - state.last_s + reading.duration_s)
    reach = max(GATE_STEPS * sensor.step, possible, GATE * math.sqrt(widest))
    # What is unseen for long could be anywhere, but no more where the thermometer sticks.
    if not state.repeats(reading) and abs(reading.last - mean) < reach:
        state.trusts()
        if max(abs(reading.low - mean), abs(reading.high - mean)) < reach and not sensor.leaps(reading):
            state.lively |= reading.changes > 0
            measure(bank.filters, said(reading, sensor))
        return bank
    if not state.believes(reading):
        return bank
    state.trusts()
    before = sensor.means[-2] if len(sensor.means) > 1 else reading.mean
    slope = (reading.mean - before) / max(reading.time_s - state.last_s, 1e-6)
    temperature = (reading.mean, _start_sd(reading, sensor))
    return started(temperature, (slope, 0.5 * abs(slope)), sensor.slow_errors, bank.kinds)


def _shown(state: State, means: Merged, end_s: float, fresh: bool) -> Shown:
    """Return what is shown from the end of the slot on."""
    ahead = end_s - state.time_s
    temperature = means.temperature + ahead * means.rate
    rate = means.rate + ahead * means.acceleration
    frozen = min(DRIFT_PER_S * max(end_s - state.sensor.changed_s - FROZEN_S, 0.0), UNSEEN_RATE)
    unseen = state.sensor.finder.unseen
    late = abs(rate) * min(state.sensor.interval_s, SLOW_S) / math.sqrt(3.0)
    moved = COARSEST / math.sqrt(6.0) / max(end_s, 1.0) if unseen else 0.0
    shown = Shown(
        end_s,
        temperature,
        rate,
        means.acceleration,
        math.sqrt(
            max(means.temperature_variance, 0.0)
            + state.sensor.hidden**2
            + late**2
            + UNAVERAGED**2 * (means.slow + means.walked)
        ),
        math.sqrt(max(means.rate_variance, 0.0) + frozen**2 + moved**2),
    )
    if not fresh:
        before = state.shown
        age = end_s - before.time_s
        fade = math.exp(-age / GLIDE_S)
        left = before.temperature + age * before.rate + fade * before.temperature_left - temperature
        if abs(left) > max(SURPRISING * before.temperature_sd, 0.5 * state.sensor.step):
            left = 0.0
        rate_left = before.rate + age * before.acceleration + fade * before.rate_left - rate
        return shown._replace(temperature_left=left, rate_left=rate_left)
    return shown


@njit
def extrapolate(
    time_ns: IntArray, segment: IntArray, reading: FloatArray, shown: Shown, origin: tuple[int, int],
    scatter: float, late_s: float, before: float, temperature: FloatArray, rate: FloatArray,
    temperature_sd: FloatArray, rate_sd: FloatArray,
) -> None:  # fmt: skip
    """Write temperature, rate and their standard deviations at samples, (n,) each, from what is shown.

    `origin` is the time and the segment that its time refers to.  Before the first slot of a segment ends,
    and after a gap of `late_s` before the next does, there is the reading, with its scatter (NaN
    while nothing tells it); what the rate has done in the gap nobody saw, but where it led to.  Until a slot
    ends a temperature may begin to move, and two readings in a row (`before` is that before the first),
    which no single spike makes, show it; a fault has moved faster since the slot before.
    """
    for i in range(len(time_ns)):
        age = (time_ns[i] - origin[0]) * 1e-9 - shown.time_s
        known = segment[i] == origin[1] and age >= 0.0
        late = known and age > late_s and math.isfinite(shown.rate)
        if known and not late:
            fade = math.exp(-age / GLIDE_S)
            left, rate_left = fade * shown.temperature_left, fade * shown.rate_left
            at = shown.temperature + age * shown.rate + left
            low, high = min(before, reading[i]) - shown.reach, max(before, reading[i]) + shown.reach
            off = min(at - low, 0.0) + max(at - high, 0.0)
            unsure = not shown.lively and math.isfinite(reading[i])
            beyond = max(abs(reading[i] - at) - shown.reach, 0.0) if unsure else 0.0
            off = off if abs(off) < FASTEST * (SLOT_S + age) else 0.0
            temperature[i] = at - off
            rate[i] = shown.rate + age * shown.acceleration + rate_left
            temperature_sd[i] = math.hypot(shown.temperature_sd, left) + max(abs(off), beyond)
            rate_sd[i] = math.hypot(shown.rate_sd, rate_left)
        elif math.isfinite(reading[i]):
            temperature[i], rate[i], temperature_sd[i], rate_sd[i] = reading[i], 0.0, scatter, FASTEST
            if late:
                # Where the reading is not where the rate led, the rate is another: in the mean by so much.
                astray = abs(reading[i] - shown.temperature - age * shown.rate)
                changed = 2.0 * max(astray - scatter, 0.0) / age
                unseen = math.hypot(min(START_ACCELERATION * age, UNSEEN_RATE), changed)
                rate[i], rate_sd[i] = shown.rate, math.hypot(shown.rate_sd, unseen)
        else:
            temperature[i] = rate[i] = temperature_sd[i] = rate_sd[i] = math.nan
        before = reading[i]
