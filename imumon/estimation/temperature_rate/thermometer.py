"""What is learned of a thermometer from its readings: step, noise, independent readings, repeat time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from imumon.estimation.temperature_rate.model import SLOT_S
from imumon.filters.rates import FASTEST_RATE

COARSEST_DEGC = 1.0
"""Step that is assumed until a reading changes, °C: that of the coarsest thermometers."""
TINY_DEGC = 1e-5
"""Readings closer than this are equal, °C."""
MEMORY = 1.0 / 32.0
"""Weight of a new slot in a running mean."""
OUTLIER = 9.0
"""A slot counts in a variance with at most so many times what is known."""
REVERSALS = 3
"""So often must a reading go back within `MOST_REPEAT_S` until its noise is known to reach over an edge."""
MOST_REPEAT_S = 60.0
"""Longest time that a reading is taken to be repeated, s."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The readings of one slot; all values are in °C or °C², times in s since the segment began."""

    start_s: float
    end_s: float
    """Times of the first and the last sample."""
    count: int
    """Readings; without any, all below is NaN or zero."""
    mean: float
    variance: float
    low: float
    high: float
    before: float
    """The last reading before the slot; the first in it if that is long ago."""
    first: float
    last: float
    changes: int
    """How many readings differ from the one before, in the slot and into it."""
    step_squares: float
    """Sum of the squares of these differences."""
    gap_s: float
    """Time between two samples."""

    @property
    def spacing_s(self) -> float:
        """Time from one such slot to the next."""
        return max(SLOT_S, self.gap_s)

    @property
    def time_s(self) -> float:
        """Middle of the slot, which its mean refers to."""
        return 0.5 * (self.start_s + self.end_s)

    @property
    def lowest(self) -> float:
        """Lowest reading, the last one before the slot included."""
        return min(self.low, self.before)

    @property
    def highest(self) -> float:
        """Highest reading, the last one before the slot included."""
        return max(self.high, self.before)

    def newest(self, repeat_s: float) -> Reading:
        """Return the last reading alone, which is measured every `repeat_s`."""
        last = self.last
        return replace(
            self, count=1, variance=0.0, gap_s=repeat_s, mean=last, low=last, high=last, first=last
        )


@dataclass(slots=True)
class StepFinder:
    """Finds the quantization step: the least change, of which the others are multiples."""

    size: float = COARSEST_DEGC
    """The step as far as it is known, °C: one that is declared holds until the first change."""
    multiples: int = 0
    """Changes that were multiples of it, since it was first found."""
    changes: int = 0
    """All changes since then."""
    misfit: float = 0.0
    """Running share of changes that are no multiples of it."""

    @property
    def confirmed_step(self) -> float | None:
        """The step in °C, None while fewer than 8 changes or too many that are no multiples show it."""
        return self.size if self.multiples >= 8 and self.misfit < 0.2 and self.size >= 1e-4 else None

    def learn(self, change: float) -> None:
        """Learn from the distance of two readings, °C."""
        if not change > TINY_DEGC or (self.multiples == 0 and change > 2.0 * COARSEST_DEGC):
            return  # equal, or a first change of which only a fault is capable
        self.changes += 1
        ratio = change / self.size
        if self.multiples == 0 or ratio < 0.75:
            self.size, self.misfit, self.multiples, self.changes = change, 0.0, 1, 1
        elif ratio <= 8.5:  # farther multiples are met by chance
            whole = round(ratio)
            fits = abs(ratio - whole) < 0.2  # 0.0625 written with two digits is off by a sixth
            self.misfit += MEMORY * ((not fits) - self.misfit)
            self.multiples += fits
            if fits and whole == 1:
                self.size += (change - self.size) / min(self.multiples, 64)

    def contradiction(self, declared: float) -> str | None:
        """Return what the readings show in place of a declared step in °C, or None."""
        if self.confirmed_step is not None and abs(self.confirmed_step / declared - 1.0) > 0.2:
            return f"the readings change in steps of {self.confirmed_step:.4g} °C, not of {declared:.4g} °C"
        if self.confirmed_step is None and self.changes >= 100:
            return f"the readings do not change in steps of {declared:.4g} °C, nor in any other"
        return None


@dataclass(slots=True)
class Thermometer:
    """Running numbers that describe a thermometer; they outlive segments."""

    finder: StepFinder = field(default_factory=StepFinder)
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
    reversals: int = 0
    interval_s: float = 0.0
    """Least time between two changes."""
    usual_s: float = 0.0
    """Mean time between slots that change."""
    change: float = 0.0
    """The last change of the reading in this segment, °C; 0 before the first."""
    changed_s: float = math.nan
    """When that was, or before it when the first reading was, s."""
    fresh_s: float = -math.inf
    """When the last reading came that was not a repeat."""
    leapt: bool = False
    """Whether a reading has skipped a code after a silence: a temperature passes each, a repeat does not."""
    repeat_s: float = 0.0
    """How long a reading is repeated: the least time between changes; 0 unless noise or a leap shows it."""

    @property
    def step(self) -> float:
        """The step d in °C as far as it is known."""
        return self.finder.size

    @property
    def noise_scale(self) -> float:
        """Unit of the noise of code models, °C²: a step squared, or ρ where that is larger."""
        return max(self.step**2, self.rho)

    @property
    def variance(self) -> float:
        """Variance that a slot's mean has at least, ρ or that of rounding, °C²."""
        return max(self.rho, self.step**2 / 12.0)

    @property
    def ripple_variance(self) -> float:
        """Variance of the ripple β d/π sin 2πT/d that a mean of rounded readings follows, °C²."""
        white = self.scatter / self.step**2 - 1.0 / 12.0
        beta = math.exp(-2.0 * math.pi**2 * max(white, 0.0)) if self.scatter else 0.0
        return (beta * self.step / math.pi) ** 2 / 2.0

    @property
    def reading_sd(self) -> float:
        """Standard deviation of a single reading, °C; NaN before the first slot."""
        return math.sqrt(self.step**2 / 12.0 + max(self.scatter, self.rho)) if self.slots else math.nan

    def independent(self, reading: Reading) -> float:
        """Return how many independent readings a slot has (von Neumann's ratio), 1 at least."""
        known = self.squared_if_independent > 0.0
        share = self.squared_differences / self.squared_if_independent if known else 1.0
        return min(max(share * reading.count, 1.0), reading.count)

    def is_dead(self, now_s: float) -> bool:
        """Return whether noise of more than a step has stopped for a minute and ten usual intervals."""
        # From one repeat to the next a ramp scatters, too.
        noise = self.rho if self.repeat_s else self.scatter
        return noise > self.step**2 and now_s - self.changed_s > max(60.0, 10.0 * self.usual_s)

    def begin(self) -> None:
        """Begin a segment; what is known of the sensor stays."""
        self.means, self.change, self.changed_s, self.fresh_s = (), 0.0, math.nan, -math.inf

    def learn(self, reading: Reading) -> Reading | None:
        """Learn from a slot that has readings; return what of it was not measured before, None if nothing.

        A reading repeated for longer than a slot counts once: when it changes, or when that is overdue.
        """
        overdue = reading.end_s - self.fresh_s >= self.repeat_s + SLOT_S
        fresh: Reading | None = reading
        if self.repeat_s >= 0.9 * SLOT_S:
            fresh = reading.newest(self.repeat_s) if reading.changes or overdue else None
        if fresh is not None:
            self.slots += 1
            self.means, self.fresh_s = (*self.means[-2:], fresh.mean), fresh.end_s
            self.spacing_s = fresh.spacing_s
        if reading.changes:
            single = math.sqrt(reading.step_squares) if reading.changes == 1 else 0.0
            for change in (single, abs(reading.first - reading.before), reading.highest - reading.lowest):
                self.finder.learn(change)
        if fresh is not None and len(self.means) == 3:
            bend = (self.means[0] - 2.0 * self.means[1] + self.means[2]) ** 2 / 6.0
            known = self.variance if self.slots > 8 else COARSEST_DEGC**2
            self.rho += max(MEMORY, 1.0 / max(self.slots - 2, 1)) * (min(bend, OUTLIER * known) - self.rho)
        if reading.changes:
            self._learn_scatter(reading)
            self._learn_repeats(reading)
        elif not math.isfinite(self.changed_s):
            self.changed_s = reading.time_s
        return fresh

    def _learn_scatter(self, reading: Reading) -> None:
        apart = self.means[-1] - self.means[-2] if len(self.means) > 1 else 0.0
        variance = reading.variance + 0.5 * apart**2
        known = max(self.scatter, self.step**2 / 4.0) if self.changed_slots else COARSEST_DEGC**2
        if variance < OUTLIER * known:
            self.changed_slots += 1
            weight = max(MEMORY, 1.0 / self.changed_slots)
            independent = 2.0 * reading.count * variance
            self.scatter += weight * (variance - self.scatter)
            self.squared_differences += weight * (reading.step_squares - self.squared_differences)
            self.squared_if_independent += weight * (independent - self.squared_if_independent)

    def _learn_repeats(self, reading: Reading) -> None:
        change = reading.last - reading.before
        single = reading.changes <= 1
        silent_s = reading.time_s - self.changed_s if self.change else math.nan
        back = change * self.change < 0.0 and silent_s < MOST_REPEAT_S
        # A code that is read once in a hundred times shows no edge: its noise could be of any size.
        shared = min(reading.mean - reading.lowest, reading.highest - reading.mean) > 0.1 * self.step
        self.reversals += (reading.changes > 1 or back) and (shared or not reading.variance)
        possible = 1.5 * self.step < abs(change) < FASTEST_RATE * silent_s
        self.leapt |= single and possible and silent_s > 2.0 * SLOT_S
        gap_s = silent_s if single else SLOT_S / reading.changes
        if math.isfinite(gap_s):
            longest = 1.01 * max(self.interval_s, reading.gap_s)
            self.interval_s = min(gap_s, longest) if self.interval_s else gap_s
        if math.isfinite(silent_s):
            self.usual_s += (MEMORY if self.usual_s else 1.0) * (silent_s - self.usual_s)
        shown = self.leapt or self.reversals >= REVERSALS
        repeats = shown and self.interval_s > 1.5 * reading.gap_s
        self.repeat_s = min(self.interval_s, MOST_REPEAT_S) if repeats else 0.0
        self.change, self.changed_s = change, reading.time_s
