"""What is learned of a thermometer from its readings: step, noise, independent readings, repeat time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

FASTEST_RATE = 20.0 / 60.0
"""Fastest that a thermometer beside an IMU moves, °C/s: 20 °C/min, twice a fast chamber."""
UNSEEN_RATE = 200.0 / 3600.0
"""Standard deviation of an unobserved rate, °C/s: of a board that warms by 20 °C with 6 min, at its start."""
SLOT_S = 1.0
"""Samples are summarised over slots of this length, s."""
UNKNOWN_STEP_DEGC = 1.0
"""Step that is assumed until a reading changes, °C: that of the coarsest thermometers."""
LARGEST_STEP_DEGC = 2.0
"""A first change that is larger is no step, °C."""
MEMORY_SLOTS = 32
"""Length of running means.  Ablation: 16 and 64 change errors by at most 9 %."""
REVERSALS = 3
"""So often must a reading go back within `MOST_REPEAT_S` until its noise is known to reach over an edge."""
MOST_REPEAT_S = 60.0
"""Longest time that a reading is taken to be repeated, s."""


@dataclass(frozen=True, slots=True)
class Slot:
    """The readings of one slot; all values are in °C or °C², times in s since the segment began."""

    time_s: float
    """Middle of the slot, which its mean refers to."""
    end_s: float
    gap_s: float
    """Time between two samples."""
    spacing_s: float
    """Time from one such slot to the next."""
    count: int
    """Readings; without any, all below is NaN or zero."""
    mean: float
    variance: float
    low: float
    high: float
    before: float
    """The last reading before the slot that was no fault; the first in it if that is long ago."""
    first: float
    last: float
    changes: int
    """How many readings differ from the one before, in the slot and into it."""
    step_squares: float
    """Sum of the squares of these differences."""

    @property
    def lowest(self) -> float:
        """Lowest reading, the last one before the slot included."""
        return min(self.low, self.before)

    @property
    def highest(self) -> float:
        """Highest reading, the last one before the slot included."""
        return max(self.high, self.before)


@dataclass(slots=True)
class Thermometer:
    """Running numbers that describe a thermometer; they outlive segments."""

    step: float = UNKNOWN_STEP_DEGC
    """The quantization step d as far as it is known, °C: the least change, of which others are multiples; one
    that is declared holds until the first change."""
    multiples: int = 0
    """Changes that were multiples of it."""
    slots: int = 0
    """Slots whose mean was measured."""
    means: tuple[float, ...] = ()
    """Means of the last of them, up to three."""
    spacing_s: float = SLOT_S
    """Time from one of them to the next."""
    rho: float = 0.0
    """Variance ρ of a slot's mean, from second differences of three slots, °C²."""
    scatter: float = 0.0
    """Mean variance of the readings of slots in which they change, °C²."""
    squared_differences: float = 0.0
    """Mean sum of squared differences of successive readings in these slots, °C²."""
    squared_if_independent: float = 0.0
    """What that would be if the readings were independent: 2 n times their variance, °C²."""
    changed_slots: int = 0
    """Slots in these three means."""
    reversals: int = 0
    """How often a reading went back to where it came from."""
    interval_s: float = 0.0
    """Least time between two changes."""
    last_change: float = math.nan
    """By how much the reading changed in the last slot of this segment in which it did, °C; NaN before."""
    changed_s: float = math.nan
    """When that was, or before it when the first reading was, s."""
    fresh_s: float = -math.inf
    """When the last reading came that was not a repeat."""
    leapt: bool = False
    """Whether a reading has skipped a code after a silence: a temperature passes each, a repeat does not."""
    repeat_s: float = 0.0
    """How long a reading is repeated: the least time between changes; 0 unless noise or a leap shows it."""

    @property
    def neighbour_s(self) -> float:
        """Readings farther apart than 10 s, and than three usual intervals, are no neighbours, s."""
        return max(10.0, 3.0 * self.spacing_s)

    @property
    def variance(self) -> float:
        """Variance that a slot's mean has at least, ρ or that of rounding, °C²."""
        return max(self.rho, self.step**2 / 12.0)

    @property
    def reading_sd(self) -> float:
        """Standard deviation of a single reading, °C; NaN before the first slot."""
        return math.sqrt(self.step**2 / 12.0 + max(self.scatter, self.rho)) if self.slots else math.nan

    def independent(self, slot: Slot) -> float:
        """Return how many independent readings a slot has (von Neumann's ratio), 1 at least."""
        known = self.squared_if_independent > 0.0
        share = self.squared_differences / self.squared_if_independent if known else 1.0
        return min(max(share * slot.count, 1.0), slot.count)

    def is_dead(self, slot: Slot) -> bool:
        """Return whether noise of more than a step has stopped for a minute and ten slots."""
        noise = self.rho if self.repeat_s else self.scatter  # from repeat to repeat a ramp scatters, too
        silent_s = slot.time_s - self.changed_s
        return not slot.changes and noise > self.step**2 and silent_s > max(60.0, 10.0 * self.spacing_s)

    def leaps(self, slot: Slot) -> bool:
        """Return whether a reading skips a code after a silence of more than two slots.

        A temperature passes every code.  So the reading was repeated, and the temperature may have moved for
        as long as it was.
        """
        silent_s = self._silent_s(slot)
        possible = 1.5 * self.step < abs(slot.last - slot.before) < FASTEST_RATE * silent_s
        return slot.changes <= 1 and possible and silent_s > 2.0 * SLOT_S

    def begin(self) -> None:
        """Begin a segment; what is known of the sensor stays."""
        self.means, self.last_change, self.changed_s, self.fresh_s = (), math.nan, math.nan, -math.inf

    def unrepeated(self, slot: Slot) -> Slot | None:
        """Return what of a slot was not measured before, None if nothing.

        A reading repeated for longer than a slot counts once: when it changes, or when that is overdue.
        """
        if not slot.count or self.repeat_s < 0.9 * SLOT_S:
            return slot if slot.count else None
        if not slot.changes and slot.end_s - self.fresh_s < self.repeat_s + SLOT_S:
            return None
        last = slot.last
        once = replace(slot, count=1, mean=last, variance=0.0, low=last, high=last, first=last)
        return replace(once, spacing_s=max(SLOT_S, self.repeat_s))

    def learn(self, slot: Slot, anew: bool) -> None:
        """Learn from a slot, no reading of which is a repeat; `anew`: the filters begin anew with it."""
        self.slots += 1
        self.means = (slot.mean,) if anew else (*self.means[-2:], slot.mean)
        self.fresh_s, self.spacing_s = slot.end_s, slot.spacing_s
        if len(self.means) == 3:
            bend = (self.means[0] - 2.0 * self.means[1] + self.means[2]) ** 2 / 6.0
            self.rho = averaged(self.rho, bend, self.slots - 2)
        if slot.changes:
            self.learn_step(abs(slot.first - slot.before))
            self.learn_step(slot.highest - slot.lowest)
            if not anew:
                self._learn_scatter(slot)
            self._learn_repeats(slot)
        if slot.changes or not math.isfinite(self.changed_s):
            self.changed_s = slot.time_s

    def learn_step(self, change: float) -> None:
        """Learn the step from the distance of two readings, °C."""
        if not change > 1e-5 or (self.multiples == 0 and change > LARGEST_STEP_DEGC):
            return  # readings that are equal but for their format, or the end of a fault
        ratio = change / self.step
        if self.multiples == 0 or ratio < 0.75:
            self.step, self.multiples = change, 1
        elif ratio <= 8.5 and abs(ratio - round(ratio)) < 0.2:  # 0.0625 with two digits is off by a sixth
            self.multiples += 1
            if ratio < 1.5:
                self.step += (change - self.step) / min(self.multiples, 64)

    def _learn_scatter(self, slot: Slot) -> None:
        variance = slot.variance + 0.5 * (self.means[-1] - self.means[-2]) ** 2
        self.changed_slots = n = self.changed_slots + 1
        self.scatter = averaged(self.scatter, variance, n)
        self.squared_differences = averaged(self.squared_differences, slot.step_squares, n)
        self.squared_if_independent = averaged(self.squared_if_independent, 2.0 * slot.count * variance, n)

    def _learn_repeats(self, slot: Slot) -> None:
        change, silent_s = slot.last - slot.before, self._silent_s(slot)
        one_way = (slot.highest - slot.lowest) / self.step
        back = change * self.last_change < 0.0 and silent_s < MOST_REPEAT_S
        self.reversals += slot.changes > one_way + 0.5 or back
        self.leapt |= self.leaps(slot)
        gap_s = silent_s if slot.changes <= 1 else SLOT_S / slot.changes
        if math.isfinite(gap_s):
            longest = 1.01 * max(self.interval_s, slot.gap_s)
            self.interval_s = min(gap_s, longest) if self.interval_s else gap_s
        repeats = (self.leapt or self.reversals >= REVERSALS) and self.interval_s > 1.5 * slot.gap_s
        self.repeat_s = min(self.interval_s, MOST_REPEAT_S) if repeats else 0.0
        self.last_change = change

    def _silent_s(self, slot: Slot) -> float:
        """Return the time since the last change, s, NaN where there was none."""
        return math.nan if math.isnan(self.last_change) else slot.time_s - self.changed_s


def averaged(mean: float, value: float, count: int) -> float:
    """Return a running mean after its value of this number, from 1: over the last `MEMORY_SLOTS` of them."""
    return mean + (value - mean) / min(count, MEMORY_SLOTS)
