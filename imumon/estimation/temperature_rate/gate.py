"""The gate before the filters: what of a thermometer is a fault and not a temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from imumon.estimation.temperature_rate.thermometer import SLOT_S, Slot, Thermometer
from imumon.filters.rates import FASTEST_RATE

GATE_SIGMA, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A slot is an outlier that lies so many sigmas, so many steps, and farther than a temperature moves from the
prediction; after so many slots it may be the truth.  Assumed: wide, as the filters weigh what is nearer."""
SPIKE = 8.0
"""A slot has a spike that spans more than so many °C and more than so many steps.  Assumed."""


class Outcome(Enum):
    """A slot only predicts (nothing is learned of the thermometer), is a measurement, or a restart."""

    PREDICT = auto()
    USE = auto()
    RESTART = auto()


@dataclass(slots=True)
class Gate:
    """State of the gate in one segment."""

    used_s: float = -math.inf
    """Time of the last slot that was a temperature, s."""
    rejected: int = 0
    """Outliers in a row."""
    outlier_degc: float = math.nan
    """The one reading of all of them, °C; NaN if they differ."""

    @property
    def sticks(self) -> bool:
        """Whether the thermometer has stuck at one reading since a leap."""
        return self.rejected >= GATE_SLOTS and math.isfinite(self.outlier_degc)

    def decide(self, slot: Slot, thermometer: Thermometer, expected: tuple[float, float] | None) -> Outcome:
        """Return the outcome of a slot that has readings: that of the first row that holds.

        `expected` are mean and variance of the predicted reading, °C and °C²; None without an estimate.
        """
        dead = thermometer.is_dead(slot)
        spike = slot.high - slot.low > SPIKE * max(1.0, thermometer.step)
        stuck = slot.low == slot.high == self.outlier_degc
        near = expected is not None and self._is_near(slot, thermometer, *expected)
        power_on = math.isnan(thermometer.last_change)
        repeats = not thermometer.repeat_s and thermometer.leaps(slot)
        lasts = self.rejected + 1 >= GATE_SLOTS
        table = (
            (dead, Outcome.PREDICT),  # noise of more than a step has stopped
            (spike, Outcome.PREDICT),
            (stuck, Outcome.PREDICT),  # the same reading since a leap, as 85 °C of a restart
            (expected is None, Outcome.RESTART),
            (near, Outcome.USE),  # a temperature may be there by now
            (power_on, Outcome.RESTART),  # the reading had never changed: it was a value at power-on
            (repeats, Outcome.RESTART),  # repeated readings were taken for new ones
            (lasts, Outcome.RESTART),  # a new temperature
            (True, Outcome.PREDICT),
        )
        outcome = next(outcome for holds, outcome in table if holds)
        if outcome is not Outcome.PREDICT:
            self.used_s, self.rejected, self.outlier_degc = slot.time_s, 0, math.nan
        elif not (dead or spike):
            self.outlier_degc = slot.last if stuck or not self.rejected else math.nan
            self.rejected += 1
        return outcome

    def _is_near(self, slot: Slot, thermometer: Thermometer, mean: float, variance: float) -> bool:
        """Return whether a temperature may have got there since it was last observed."""
        noise = variance + thermometer.step**2 + thermometer.scatter + thermometer.rho
        moved = FASTEST_RATE * (slot.time_s - self.used_s + SLOT_S)
        reach = max(GATE_STEPS * thermometer.step, moved, GATE_SIGMA * math.sqrt(noise))
        return max(slot.high - mean, mean - slot.low) < reach
