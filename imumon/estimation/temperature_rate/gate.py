"""The gate before the filters: what of a thermometer is a fault and not a temperature.

One decision table, evaluated top down, per slot:

| the slot | outcome |
|---|---|
| shows that noise of more than a step has stopped: a dead sensor | PREDICT |
| spans more than any noise: a spike | PREDICT |
| comes where there is no estimate, and is not stuck | RESTART |
| is where a temperature may be by now, and not stuck | USE |
| is an outlier, and the reading had never changed: the code before was a value at power-on | RESTART |
| is an outlier, and just proves that readings are repeated, which were taken for new ones | RESTART |
| is an outlier for less than three slots | PREDICT |
| is an outlier, and the same since the leap: stuck (85 °C of a restart) | PREDICT |
| is an outlier otherwise: a new temperature | RESTART |
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from imumon.estimation.temperature_rate.model import SLOT_S
from imumon.estimation.temperature_rate.thermometer import COARSEST_DEGC, Reading, Thermometer
from imumon.filters.rates import FASTEST_RATE

GATE_SIGMA, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A slot is an outlier that lies so many sigmas, so many steps, and farther than a temperature moves from the
prediction; after so many slots it may be the truth.  Assumed: wide, as the filters weigh what is nearer."""

NEIGHBOUR_S, LATE_INTERVALS = 10.0, 3.0
"""Readings are neighbours that are no farther apart than this, s, or than so many usual intervals."""


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
    interval_s: float = 0.0
    """Time from the one before to it, s."""
    has_changed: bool = False
    """Whether the reading has changed in this segment."""
    rejected: int = 0
    """Outliers in a row."""
    outlier_degc: float = math.nan
    """Last reading of the first of them, °C."""
    constant: bool = False
    """Whether the reading is the same since."""

    def decide(
        self, reading: Reading, thermometer: Thermometer, expected: tuple[float, float] | None
    ) -> Outcome:
        """Return the outcome of a slot that has readings.

        Parameters
        ----------
        expected : tuple of float, optional
            Mean and variance of the predicted reading, °C and °C²; None without an estimate.
        """
        widest = max(thermometer.step, COARSEST_DEGC, math.sqrt(thermometer.scatter))
        if thermometer.is_dead(reading.time_s) or reading.high - reading.low > GATE_SIGMA * widest:
            return Outcome.PREDICT
        same = reading.low == reading.high == self.outlier_degc
        sticks = self.rejected > 0 and self.constant and same
        if expected is None:
            return Outcome.PREDICT if sticks else Outcome.RESTART
        mean, variance = expected
        noise = variance + thermometer.step**2 + thermometer.scatter + thermometer.rho
        moved = FASTEST_RATE * (reading.time_s - self.used_s + SLOT_S)
        reach = max(GATE_STEPS * thermometer.step, moved, GATE_SIGMA * math.sqrt(noise))
        # What has not been observed for long could be anywhere, but no more where the thermometer sticks.
        if max(reading.high - mean, mean - reading.low) < reach and not sticks:
            self.accept(reading)
            self.has_changed |= reading.changes > 0
            return Outcome.USE
        if not self.rejected:
            self.outlier_degc, self.constant = reading.last, True
        else:
            self.constant &= same
        self.rejected += 1
        lasts = self.rejected >= GATE_SLOTS and not self.constant
        return Outcome.RESTART if lasts or not self.has_changed else Outcome.PREDICT

    def accept(self, reading: Reading) -> None:
        """Note a slot that is a temperature."""
        if math.isfinite(self.used_s):
            self.interval_s = reading.time_s - self.used_s
        self.used_s, self.rejected = reading.time_s, 0

    @property
    def neighbour_s(self) -> float:
        """Readings farther apart than this are no neighbours, s."""
        return max(NEIGHBOUR_S, LATE_INTERVALS * self.interval_s)
