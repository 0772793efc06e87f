"""The gate before the filters: what of a thermometer is a fault and not a temperature.

One decision table, evaluated top down, per slot:

| the slot | outcome |
|---|---|
| has no readings | PREDICT |
| noise of more than a step has stopped: a dead sensor | PREDICT |
| ends where a temperature may be by now, but spans a spike | PREDICT |
| ends where a temperature may be by now | USE |
| is off for less than three slots | PREDICT |
| is off, and the same since the leap, after readings that changed: stuck (85 °C of a restart) | PREDICT |
| is off, neither level ever changed, and the later is there for no longer: a value at power-on | PREDICT |
| is off otherwise: a new level | RESTART |
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from imumon.estimation.temperature_rate.model import SLOT_S
from imumon.estimation.temperature_rate.sensor import COARSEST_DEGC, Reading, Thermometer
from imumon.filters.rates import FASTEST_RATE

GATE_SIGMA, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A slot is off where it lies so many sigmas, so many steps, and farther than a temperature moves from the
prediction; after so many slots it may be the truth."""


class Outcome(Enum):
    """What is done with a slot."""

    PREDICT = auto()
    """Nothing is measured."""
    USE = auto()
    """The slot is a measurement."""
    RESTART = auto()
    """The filters begin anew at the readings."""


@dataclass(slots=True)
class Gate:
    """State of the gate in one segment."""

    used_s: float = -math.inf
    """Time of the last slot that was a temperature, s."""
    rejected: int = 0
    """Slots in a row that were off."""
    stuck_degc: float = math.nan
    """Last reading of the first of them, °C; NaN once the reading has changed."""
    stuck_since_s: float = math.nan
    """Time of the first of them, s."""
    has_changed: bool = False
    """Whether the reading has changed in this segment."""
    stuck_at: float = math.nan
    """Where readings stuck last, °C; NaN if they never did.  It outlives segments, for the notice."""

    def begin(self) -> None:
        """Begin a segment."""
        self.used_s, self.rejected, self.has_changed = -math.inf, 0, False
        self.stuck_degc = self.stuck_since_s = math.nan

    def decide(self, reading: Reading, thermometer: Thermometer, mean: float, variance: float) -> Outcome:
        """Return the outcome of a slot; mean and variance are of the predicted reading, °C and °C²."""
        if not reading.count or thermometer.is_dead(reading.time_s):
            return Outcome.PREDICT
        noise = variance + thermometer.step**2 + thermometer.scatter + thermometer.rho
        moved = FASTEST_RATE * (reading.time_s - self.used_s + SLOT_S)
        reach = max(GATE_STEPS * thermometer.step, moved, GATE_SIGMA * math.sqrt(noise))
        # What has not been observed for long could be anywhere, but no more where the thermometer sticks.
        if abs(reading.last - mean) < reach and not self.is_stuck(reading):
            self.accept(reading)
            spike = max(reading.high - mean, mean - reading.low) >= reach or spans_a_fault(
                reading, thermometer
            )
            self.has_changed |= reading.changes > 0 and not spike
            return Outcome.PREDICT if spike else Outcome.USE
        return Outcome.RESTART if self._is_new_level(reading, thermometer) else Outcome.PREDICT

    def accept(self, reading: Reading) -> None:
        """Note a slot that is a temperature."""
        self.used_s, self.rejected, self.stuck_degc = reading.time_s, 0, math.nan

    def last_valid_s(self, reading: Reading, thermometer: Thermometer) -> float:
        """Return since when there is no reading to rely on, s; the last use where the sensor works."""
        if self.is_stuck(reading):
            return self.stuck_since_s
        return thermometer.changed_s if thermometer.is_dead(reading.time_s) else self.used_s

    def other_level(self, reading: Reading) -> float:
        """Return the other of two levels of which either may be the fault, °C; NaN where there is none."""
        if not self.rejected or self.has_changed:
            return math.nan
        return self.stuck_degc if math.isfinite(self.stuck_degc) else reading.last

    def is_stuck(self, reading: Reading) -> bool:
        """Return whether readings leapt as no temperature does, and are exactly the same since."""
        return self.rejected > 0 and reading.count > 0 and reading.low == reading.high == self.stuck_degc

    def _is_new_level(self, reading: Reading, thermometer: Thermometer) -> bool:
        """Count a slot that is off, and return whether it is the truth all the same."""
        self.rejected += 1
        if self.rejected == 1:
            self.stuck_degc, self.stuck_since_s = reading.last, reading.time_s
        elif not self.is_stuck(reading):
            # Noise and temperature move it; a leap is another fault.
            noise = math.sqrt(thermometer.scatter + thermometer.rho)
            moves = max(GATE_SIGMA * max(thermometer.step, noise), FASTEST_RATE * 2.0 * SLOT_S)
            if max(abs(reading.low - self.stuck_degc), abs(reading.high - self.stuck_degc)) > moves:
                self.rejected, self.stuck_degc, self.stuck_since_s = 1, reading.last, reading.time_s
            else:
                self.stuck_degc = math.nan
        if math.isnan(self.stuck_degc):
            return self.rejected >= GATE_SLOTS
        if self.rejected == GATE_SLOTS:
            self.stuck_at = self.stuck_degc
        return not self.has_changed and reading.time_s - self.stuck_since_s > self.stuck_since_s


def spans_a_fault(reading: Reading, thermometer: Thermometer) -> bool:
    """Return whether a slot spans more than the noise and steps of any thermometer."""
    noise = max(thermometer.step, COARSEST_DEGC, math.sqrt(thermometer.scatter))
    return reading.high - reading.low > GATE_SIGMA * noise
