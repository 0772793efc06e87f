"""What is learned of a thermometer from its readings: step, noise, and how long a reading is repeated."""

import math
from dataclasses import dataclass, replace

FASTEST_RATE = 20.0 / 60.0
"""Fastest rate beside an IMU, °C/s: 20 °C/min, twice a fast chamber.  Also the sd of a rate not known."""
UNSEEN_RATE = 200.0 / 3600.0
"""Rate at the start of a warm-up, °C/s: of a board that warms by 20 °C with a time constant of 6 min."""
SLOT_S = 1.0  # samples are summarised over slots of this length, s
UNKNOWN_STEP_DEGC = 1.0  # step that is assumed until a reading changes, °C: that of the coarsest thermometers
LARGEST_STEP_DEGC = 2.0  # a change that is larger is no step, °C
SPIKE = 8.0
"""A temperature moves by less than so many °C, or steps, within a slot or until a repeat.  Assumed."""
MEMORY_SLOTS = 32  # length of running means.  Ablation: 16 and 64 change errors by at most 9 %.
MEMORY_CHANGES = 128
"""Changes of which the least is the step.  Ablation: with 32, every 30 s in a swing, 1.35 times the error."""
REVERSALS = 3
"""So often must a reading go back within `MOST_REPEAT_S` until its noise is known to reach over an edge."""
MOST_REPEAT_S = 60.0  # longest time that a reading is taken to be repeated, s


@dataclass(frozen=True)
class Slot:
    """The readings of one slot; values are in °C, times in s.

    Without any reading, `count` and `changes` are zero and values NaN.  The first of a segment is no change.
    """

    time_s: float  # middle of the slot, which its mean refers to
    end_s: float
    sample_s: float  # time between two readings, since the last slot that has one
    before: float  # last reading that was used before the slot; the first in it if that is long ago
    count: int  # readings
    changes: int  # readings that differ from the one before, in the slot and into it
    difference_squares: float  # sum of the squares of these differences, °C²
    mean: float
    variance: float  # °C²
    smallest: float
    largest: float
    first: float
    last: float

    @property
    def lowest(self) -> float:
        """Lowest reading, the last one before the slot included."""
        return min(self.smallest, self.before)

    @property
    def highest(self) -> float:
        """Highest reading, the last one before the slot included."""
        return max(self.largest, self.before)

    def alone(self) -> "Slot":
        """Return the slot as if there had been no reading before it."""
        return replace(self, before=self.first, changes=max(self.changes - (self.first != self.before), 0))


@dataclass
class Thermometer:
    """Running numbers that describe a thermometer; values are in °C, times in s."""

    step: float = UNKNOWN_STEP_DEGC  # quantization step d; one that is declared holds until a change
    changes: tuple[float, ...] = ()  # sizes of the last changes of the reading
    rho: float = 0.0  # variance ρ of a slot's mean, by second differences of the means of three slots, °C²
    triples: int = 0  # second differences in it
    scatter: float = 0.0  # mean variance of readings where they change, within slots and between them, °C²
    independence: float = 1.0  # mean ratio of independent to all readings there (von Neumann)
    changed_slots: int = 0  # slots in these two means
    reversals: int = 0  # how often a reading went back to where it came from
    leapt: bool = False  # whether a reading has skipped a code after a silence: then readings are repeated
    interval_s: float = math.inf  # least time between two changes; each change forgets a hundredth
    sample_s: float = 0.0  # time between two readings

    # These are since the last `begin`.
    means: tuple[float, ...] = ()  # of the last slots that were used, up to three
    last: float = math.nan  # last reading that was used
    used_s: float = -math.inf  # time of its slot
    last_change: float = math.nan  # of the reading, over the last slot in which it changed; NaN before
    changed_s: float = math.nan  # when that was; before it, when the first reading was

    @property
    def flickers(self) -> bool:
        """Whether its noise is known to reach over an edge."""
        return self.reversals >= REVERSALS

    @property
    def repeat_s(self) -> float:
        """How long a reading is repeated: the least time between changes, once noise or a leap shows it."""
        repeats = (self.leapt or self.flickers) and self.interval_s > 1.5 * self.sample_s
        return min(self.interval_s, MOST_REPEAT_S) if repeats else 0.0

    @property
    def spacing_s(self) -> float:
        """Time Δ from one slot that is used to the next, s."""
        return max(SLOT_S, self.sample_s, self.repeat_s)

    @property
    def neighbour_s(self) -> float:
        """Readings farther apart than 10 s, and than three usual intervals, are no neighbours, s."""
        return max(10.0, 3.0 * self.spacing_s)

    @property
    def mean_variance(self) -> float:
        """Variance that a slot's mean has at least, ρ or that of rounding, °C²."""
        return max(self.rho, self.step**2 / 12.0)

    def is_dead(self, slot: Slot) -> bool:
        """Return whether noise of more than a step has stopped for a minute and ten slots."""
        # White variance of a reading, the lesser of two estimates: a ramp scatters, too, but not from reading
        # to reading, nor in second differences of means.  A repeated reading is the mean of its slot.
        noise = self.rho if self.repeat_s else min(self.independence * self.scatter, slot.count * self.rho)
        silent_s = slot.time_s - self.changed_s
        return not slot.changes and noise > self.step**2 and silent_s > max(60.0, 10.0 * self.spacing_s)

    def leaps(self, slot: Slot) -> bool:
        """Return whether a reading skips a code after a silence of more than two slots.

        A temperature passes every code.  So the reading was repeated, and the temperature moved meanwhile.
        """
        silent_s = slot.time_s - self.changed_s
        farthest = min(FASTEST_RATE * silent_s, SPIKE * max(1.0, self.step))
        leaps = 1.5 * self.step < abs(slot.last - slot.before) < farthest
        return slot.changes <= 1 and leaps and silent_s > 2.0 * SLOT_S

    def begin(self) -> None:
        """Begin anew; what is known of the sensor stays."""
        self.means, self.used_s = (), -math.inf
        self.last = self.last_change = self.changed_s = math.nan

    def unrepeated(self, slot: Slot) -> Slot:
        """Return what of a slot was not measured before, with a `count` of zero if nothing.

        A reading repeated for longer than a slot counts once: when it changes, or when that is overdue.
        """
        if not slot.count or self.repeat_s < 0.9 * SLOT_S:
            return slot
        due = slot.changes or slot.time_s - self.used_s >= self.repeat_s + SLOT_S
        last = slot.last
        return replace(
            slot, count=1 if due else 0, mean=last, variance=0.0, smallest=last, largest=last, first=last
        )

    def learn(self, slot: Slot) -> None:
        """Learn from a slot, no reading of which is a repeat."""
        apart = slot.time_s - self.used_s > self.neighbour_s  # a ramp over a gap is no noise
        self.means = (slot.mean,) if apart else (*self.means[-2:], slot.mean)
        if len(self.means) == 3:
            self.triples += 1
            second_difference = self.means[0] - 2.0 * self.means[1] + self.means[2]
            self.rho = averaged(self.rho, second_difference**2 / 6.0, self.triples)
        if slot.changes:
            self._learn_change(slot)
        if slot.changes or math.isnan(self.changed_s):
            self.changed_s = slot.time_s
        self.used_s, self.last, self.sample_s = slot.time_s, slot.last, slot.sample_s

    def _learn_change(self, slot: Slot) -> None:
        """Learn from a slot in which the reading changes, or which begins with another than the last."""
        self.learn_step(abs(slot.first - slot.before) or slot.highest - slot.lowest)
        if len(self.means) > 1:
            variance = slot.variance + 0.5 * (self.means[-1] - self.means[-2]) ** 2
            most = max(2.0 * slot.count * variance, slot.difference_squares)
            self.changed_slots += 1
            self.scatter = averaged(self.scatter, variance, self.changed_slots)
            ratio = slot.difference_squares / most if most > 0.0 else 1.0
            self.independence = averaged(self.independence, ratio, self.changed_slots)
        change, silent_s = slot.last - slot.before, slot.time_s - self.changed_s
        if math.isfinite(self.last_change):
            back = change * self.last_change < 0.0 and silent_s < MOST_REPEAT_S
            self.reversals += back or slot.changes > (slot.highest - slot.lowest) / self.step + 0.5
            self.leapt |= self.leaps(slot)
            apart_s = silent_s if slot.changes <= 1 else SLOT_S / slot.changes
            self.interval_s = min(apart_s, 1.01 * max(self.interval_s, slot.sample_s))
        self.last_change = change

    def learn_step(self, change: float) -> None:
        """Learn the step from the distance of two readings, °C: the least of the last changes.

        Those that are alike are averaged: 0.0625 with two digits is off by a sixth.
        """
        if 1e-5 < change <= LARGEST_STEP_DEGC:  # no readings that are equal but for their format
            self.changes = (*self.changes[1 - MEMORY_CHANGES :], change)
            largest = 1.5 * min(self.changes)
            alike = [each for each in self.changes if each < largest]
            self.step = sum(alike) / len(alike)


def averaged(mean: float, value: float, count: int) -> float:
    """Return a running mean after its value of this number, from 1: over the last `MEMORY_SLOTS` of them."""
    return mean + (value - mean) / min(count, MEMORY_SLOTS)
