"""Temperature and rate of one thermometer, slot by slot: the bank, faults, what is shown."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.bank import (
    ACCELERATION,
    RATE,
    SLOW_SIGMA,
    START_RATE,
    TEMPERATURE,
    Bank,
    advance,
    merged,
    started,
)
from imumon.estimation.temperature_rate.measurement import confined, measured
from imumon.estimation.temperature_rate.sensor import Reading, Sensor
from imumon.estimation.temperature_rate.step import StepFinder

GLIDE_S = 3.0
"""Time constant with which what is shown follows the state, so that it does not jump."""
SURPRISING = 6.0
"""A change by so many standard deviations and half a step corrects an error: then the temperature jumps."""
ALLOWED = 2.5
"""The temperature is within half a step and so many standard deviations of the noise of the readings."""
STEP_CHANGE = 0.25
"""A step found to be so much larger is another."""
GATE, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A reading off by so many deviations and steps is a fault; after so many slots it is the truth."""
FASTER = 1.5
"""Until the next refresh a temperature moves no faster than so many times as since the last."""
GAP_S = 600.0
"""After so long without a reading, or of a dead sensor, there is no estimate; a later reading begins anew."""
LATE_S, LATE_FACTOR = 5.0, 3.0
"""Readings missed for so long, and so many times the usual interval, ..."""
UNSEEN_JERK = 1e-13
"""... let the temperature do this, °C²/s⁵, that nobody saw."""
EDGES = 0.05
"""Edges between levels are known to so many steps: ±0.1 of nonlinearity is a good converter's."""
COARSEST = 1.0
"""°C; as long as a reading has never changed, its steps may be those of the coarsest thermometers."""
FROZEN_S, DRIFT_PER_S = 3600.0, 1.0 / 3600.0**2
"""A level unchanged for an hour is trusted less: the band grows by 1 °C/h every hour, up to the start's."""

BROKEN = 5.0
"""A rate that changes by so many of its standard deviations within a slot contradicts the slot before."""
MOST_BROKEN, BROKEN_S = 6.0, 600.0
"""So many contradictions, each forgotten over this time, and no model is right: measured (see
`scripts/reproduce/thermometers`), the begin of a ramp makes 0 to 3, popcorn noise 25 to 30 in 15 minutes."""


class Shown(NamedTuple):
    """What is shown from a time on: a parabola, and remainders of what was shown before that fade away.

    Parameters
    ----------
    time_s : float
    temperature, rate, acceleration : float
        °C, °C/s, °C/s².
    temperature_sd, rate_sd : float
    temperature_left, rate_left : float
        The remainders at `time_s`.
    """

    time_s: float = 0.0
    temperature: float = np.nan
    rate: float = np.nan
    acceleration: float = np.nan
    temperature_sd: float = np.nan
    rate_sd: float = np.nan
    temperature_left: float = 0.0
    rate_left: float = 0.0


@dataclass(slots=True, eq=False)
class State:
    """All that is known of one thermometer and its temperature.

    Parameters
    ----------
    sensor : Sensor
    bank : Bank or None
        None without an estimate.
    shown : Shown
    time_s, end_s : float
        What the bank refers to, and the end of the last slot.
    last, last_s : float
        Last reading and the middle of its slot; a slot's mean before.
    usual_s : float
        Time between the last two slots with readings.
    slowest, fastest : float
        Rates that the last two readings allow until the next, °C/s; for slow refreshes.
    step : float
        The step that the bank takes the readings to have, °C.
    faults : int
        Slots that were passed over in a row.
    broken : float
        Contradictions of late: sudden changes of the rate that its standard deviation did not allow.
    refuses : bool
        Whether there are too many for an estimate: then the readings themselves are given.
    given : Shown
        What is given to the user: what is shown, or the readings.
    """

    sensor: Sensor
    bank: Bank | None = None
    shown: Shown = field(default_factory=Shown)
    time_s: float = 0.0
    end_s: float = 0.0
    last: float = np.nan
    last_s: float = -np.inf
    usual_s: float = 0.0
    slowest: float = 0.0
    fastest: float = 0.0
    step: float = 0.0
    faults: int = 0
    broken: float = 0.0
    refuses: bool = False
    given: Shown = field(default_factory=Shown)

    @classmethod
    def new(cls, step_degc: float | None) -> State:
        """Return the state before the first reading."""
        return cls(Sensor(StepFinder(step_degc)))

    def snapshot(self) -> State:
        """Return a copy."""
        return deepcopy(self)

    def begin(self) -> None:
        """Begin anew, in a new segment; what is known of the sensor stays."""
        self.bank, self.shown, self.given, self.last, self.last_s = None, Shown(), Shown(), np.nan, -np.inf
        self.sensor.changed_s, self.sensor.means = np.nan, ()


def step(state: State, reading: Reading) -> Shown:
    """Take a slot; return what is given from its end on: the bank's estimate, or the readings."""
    before = state.shown
    shown = _estimate(state, reading)
    age = max(reading.end_s - before.time_s, 0.0)
    state.broken *= float(np.exp(-age / BROKEN_S)) if before.time_s else 1.0
    change = shown.rate - before.rate - age * before.acceleration
    state.broken += bool(abs(change) > BROKEN * before.rate_sd)
    state.refuses = state.broken > (0.5 * MOST_BROKEN if state.refuses else MOST_BROKEN)
    if not state.refuses or state.bank is None:
        state.given = shown
    elif reading.count:
        state.given = _raw(state.sensor, reading)
    return state.given


def _raw(sensor: Sensor, reading: Reading) -> Shown:
    """Return the mean of a slot's readings and how far they may be off; the rate is not known (NaN)."""
    sd = float(np.sqrt(sensor.step**2 + sensor.inside + sensor.roughness))
    return Shown(reading.end_s, reading.mean, 0.0, np.nan, sd, np.nan)


def _estimate(state: State, reading: Reading) -> Shown:
    """Take a slot; return what the bank shows from its end on."""
    sensor, knew = state.sensor, state.sensor.refresh.slow
    if reading.count:
        sensor.learn(reading)
        if not np.isfinite(sensor.changed_s):
            sensor.changed_s = reading.time_s
    taken = sensor.fresh(reading) if reading.count else None
    dead = sensor.is_dead(reading.time_s)
    heard = taken is not None and not dead
    repeats = reading.count > 0 and taken is None
    if taken is not None and heard and sensor.refresh.slow and not knew:
        _begin_slow(state, reading.before, taken)
    elif state.bank is not None and sensor.step > (1.0 + STEP_CHANGE) * state.step > 0.0:
        # So far the readings were taken for finer than they are.
        state.bank = None
    seen_s = sensor.changed_s if dead else state.last_s
    if state.bank is not None and not heard and not repeats and reading.end_s - seen_s > GAP_S:
        state.bank, state.shown = None, Shown()
    fresh = state.bank is None
    if state.bank is None:
        if taken is None or dead:
            return state.shown
        state.bank = started((taken.mean, _start_sd(taken, sensor)), (0.0, 0.0), sensor.unit)
        state.step = sensor.step
        state.time_s, state.faults, state.usual_s = taken.time_s, 0, 0.0
    at = taken.time_s if taken is not None and heard else reading.end_s
    dt = max(at - state.time_s, 0.0)
    unseen = (not heard and not repeats) or dt > max(LATE_S, LATE_FACTOR * state.usual_s)
    bank = advance(state.bank, dt, sensor.unit, UNSEEN_JERK if unseen else 0.0)
    state.time_s = max(at, state.time_s)
    if taken is not None and heard:
        bank = _heard(state, bank, taken)
        if sensor.refresh.slow:
            moved, since = taken.last - state.last, FASTER / max(at - state.last_s, 1.0)
            state.slowest = min(moved - sensor.unit, 0.0) * since
            state.fastest = max(moved + sensor.unit, 0.0) * since
        state.last, state.last_s = taken.last, taken.time_s
        state.usual_s = dt
    state.bank = bank
    still = taken is not None and heard and not state.faults and not taken.changes and sensor.step > 0.0
    shown = confined(bank, taken, sensor) if taken is not None and still else bank
    state.shown = _shown(state, shown, reading.end_s, fresh)
    if (heard or repeats) and not state.faults:
        _keep_near(state, reading if taken is None else taken, reading.end_s)
    return state.shown


def _begin_slow(state: State, before: float, taken: Reading) -> None:
    """Begin anew with a sensor found to be refreshed slowly: its repeats were taken for readings."""
    sensor = state.sensor
    state.last, state.last_s = before, taken.time_s - sensor.refresh.interval_s
    moved = (taken.last - before) / sensor.refresh.interval_s
    temperature = (taken.mean, _start_sd(taken, sensor))
    state.bank = started(temperature, (0.0, abs(moved)), sensor.unit)
    state.time_s, state.faults, state.step = taken.time_s, 0, sensor.step


def _keep_near(state: State, reading: Reading, end_s: float) -> None:
    """Keep what is shown as near to the readings as they allow (the idea of the paper's equation 15).

    A reading that is repeated until the next refresh allows what the temperature may move by its age.
    """
    sensor, bank, shown = state.sensor, state.bank, state.shown
    assert bank is not None
    slow = float(bank.weight.sum(0) @ SLOW_SIGMA) * sensor.unit
    low, high = reading.low, reading.high
    if reading.changes >= 4:
        low = high = sensor.linear(reading)
    allowed = 0.5 * sensor.step + ALLOWED * float(np.hypot(np.sqrt(sensor.roughness), slow))
    if sensor.refresh.slow:
        age = max(end_s - state.last_s, 0.0)
        low, high = low + state.slowest * age, high + state.fastest * age
    temperature = shown.temperature + shown.temperature_left
    off = temperature - min(max(temperature, low - allowed), high + allowed)
    if off:
        sd = float(np.hypot(shown.temperature_sd, off))
        state.shown = shown._replace(temperature=shown.temperature - off, temperature_sd=sd)


def _start_sd(reading: Reading, sensor: Sensor) -> float:
    return float(np.hypot(sensor.step, np.sqrt(reading.variance)))


def _heard(state: State, bank: Bank, reading: Reading) -> Bank:
    """Return the bank given readings, or as it was where they are a fault."""
    sensor = state.sensor
    mean, variance = merged(bank.weight, *bank.reading)
    off = max(abs(reading.low - mean), abs(reading.high - mean))
    widest = variance + sensor.step**2 + sensor.inside + sensor.roughness
    if off < GATE_STEPS * sensor.step or off * off < GATE * GATE * widest:
        state.faults = 0
        return measured(bank, reading, sensor)
    state.faults += 1
    if state.faults < GATE_SLOTS and not sensor.refresh.slow:
        return bank
    state.faults = 0
    before = sensor.means[-2] if len(sensor.means) > 1 else reading.mean
    slope = (reading.mean - before) / max(reading.time_s - state.last_s, 1e-6)
    temperature = (reading.mean, _start_sd(reading, sensor))
    return started(temperature, (slope, 0.5 * abs(slope)), sensor.unit, bank.weight.sum(0))


def _shown(state: State, bank: Bank, end_s: float, fresh: bool) -> Shown:
    """Merge the filters into what is shown from the end of the slot on."""
    centre, spread = merged(bank.weight, bank.mean, np.diagonal(bank.covariance, axis1=-2, axis2=-1))
    ahead = end_s - state.time_s
    temperature = float(centre[TEMPERATURE] + ahead * centre[RATE])
    rate = float(centre[RATE] + ahead * centre[ACCELERATION])
    frozen = min(DRIFT_PER_S * max(end_s - state.sensor.changed_s - FROZEN_S, 0.0), START_RATE)
    unseen = state.sensor.finder.unseen
    hidden = COARSEST / np.sqrt(12.0) if unseen else EDGES * state.sensor.step
    moved = COARSEST / np.sqrt(6.0) / max(end_s, 1.0) if unseen else 0.0
    shown = Shown(
        end_s,
        temperature,
        rate,
        float(centre[ACCELERATION]),
        float(np.hypot(np.sqrt(max(spread[TEMPERATURE], 0.0)), hidden)),
        float(np.sqrt(max(spread[RATE], 0.0) + frozen**2 + moved**2)),
    )
    if not fresh:
        before = state.shown
        age = end_s - before.time_s
        fade = float(np.exp(-age / GLIDE_S))
        left = before.temperature + age * before.rate + fade * before.temperature_left - temperature
        if abs(left) > max(SURPRISING * before.temperature_sd, 0.5 * state.sensor.step):
            left = 0.0
        rate_left = before.rate + age * before.acceleration + fade * before.rate_left - rate
        return shown._replace(temperature_left=left, rate_left=rate_left)
    return shown


def extrapolated(
    shown: FloatArray, time_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return temperature, rate and their standard deviations, (n,) each.

    Parameters
    ----------
    shown : array (n, 8)
        Fields of `Shown` that hold for each sample.
    time_s : array (n,)
    """
    start, temperature, rate, acceleration, temperature_sd, rate_sd, left, rate_left = shown.T
    age = time_s - start
    fade = np.exp(-age / GLIDE_S)
    return (
        temperature + age * rate + fade * left,
        rate + age * acceleration + fade * rate_left,
        np.hypot(temperature_sd, fade * left),
        np.hypot(rate_sd, fade * rate_left),
    )
