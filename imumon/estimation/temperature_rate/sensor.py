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
"""So often a reading has to go back within `FLICKER_S` before its noise is known to reach over an edge."""
FLICKER_S = 30.0
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
    first: float
    last: float
    changes: int
    """How many readings differ from the one before, in the slot and into it."""
    step_squares: float
    """Sum of the squares of these differences."""
    before: float
    """Last reading before the slot, NaN if that is long ago."""
    gap_s: float
    """Time between two samples."""

    def newest(self, repeat_s: float) -> Reading:
        """Return the last reading of the slot alone, `repeat_s` after the one before it."""
        before = self.before if math.isfinite(self.before) else self.first
        only = dict.fromkeys(("mean", "low", "high", "first"), self.last)
        changed = int(before != self.last)
        return replace(
            self,
            count=1,
            variance=0.0,
            changes=changed,
            step_squares=0.0,
            before=before,
            gap_s=repeat_s,
            **only,
        )

    @property
    def time_s(self) -> float:
        """Middle of the slot, which its mean refers to."""
        return 0.5 * (self.start_s + self.end_s)

    @property
    def jumped(self) -> bool:
        """Whether the reading changed between the slot before and this one."""
        return math.isfinite(self.before) and self.before != self.first

    @property
    def lowest(self) -> float:
        """Lowest reading, the last one before the slot included."""
        return min(self.low, self.before) if self.jumped else self.low

    @property
    def highest(self) -> float:
        """Highest reading, the last one before the slot included."""
        return max(self.high, self.before) if self.jumped else self.high


@dataclass(slots=True)
class StepFinder:
    """Finds the quantization step: the least change, of which the others are multiples.

    Raises ValueError when the declared step is not positive.
    """

    declared: float | None = None
    """Step in °C that the device file declares."""
    size: float = COARSEST_DEGC
    """The step as far as it is known, °C."""
    multiples: int = 0
    """Changes that were multiples of it, since it was first found."""
    changes: int = 0
    """All changes since then."""
    misfit: float = 0.0
    """Running share of changes that are no multiples of it."""

    def __post_init__(self) -> None:
        """Begin with the declared step."""
        if self.declared is not None:
            if not self.declared > TINY_DEGC:
                raise ValueError(f"a step of {self.declared} °C")
            self.size = self.declared

    @property
    def step(self) -> float | None:
        """The step in °C, None while fewer than 8 changes or too many that are no multiples show it."""
        return self.size if self.multiples >= 8 and self.misfit < 0.2 and self.size >= 1e-4 else None

    @property
    def unknown(self) -> bool:
        """Whether the step is neither declared nor found."""
        return self.declared is None and self.changes == 0

    def learn(self, reading: Reading) -> None:
        """Learn from the differences between the readings of a slot."""
        single = math.sqrt(reading.step_squares) if reading.changes == 1 else 0.0
        for difference in (single, reading.first - reading.before, reading.high - reading.low):
            self.learn_change(abs(difference))

    def learn_change(self, change: float) -> None:
        """Learn from the difference of two readings, °C."""
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

    def contradiction(self) -> str | None:
        """Return what the readings show in place of the declared step, or None."""
        if self.declared is None:
            return None
        if self.step is not None and abs(self.step / self.declared - 1.0) > 0.2:
            return f"the readings change in steps of {self.step:.4g} °C, not of {self.declared:.4g} °C"
        if self.step is None and self.changes >= 100:
            return f"the readings do not change in steps of {self.declared:.4g} °C, nor in any other"
        return None


@dataclass(slots=True)
class Thermometer:
    """Running numbers that describe a thermometer; they outlive segments."""

    finder: StepFinder = field(default_factory=StepFinder)
    slots: int = 0
    means: tuple[float, ...] = ()
    """Means of the last slots, up to three."""
    rho: float = 0.0
    """Variance ρ of a slot's mean, from second differences of three slots."""
    scatter: float = 0.0
    """Mean variance of the readings of slots in which they change, °C²."""
    squared_differences: float = 0.0
    """Mean sum of squared differences of successive readings in these slots, °C²."""
    squared_if_independent: float = 0.0
    """What that would be if the readings were independent: 2 n times their variance, °C²."""
    changed_slots: int = 0
    reversals: int = 0
    leaps: int = 0
    """Changes by more than 1.5 steps after a silence: a temperature passes every level, a repeat does not."""
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
    repeats: bool = False
    """Whether noise or leaps have shown that a reading is repeated for `interval_s`."""

    @property
    def step(self) -> float:
        """The step d in °C as far as it is known."""
        return self.finder.size

    @property
    def variance(self) -> float:
        """Variance that a slot's mean has at least, ρ or that of rounding, °C²."""
        return max(self.rho, self.step**2 / 12.0, 1e-10)

    def mean_variance(self, reading: Reading) -> float:
        """Return the variance ρ of a slot's mean; that of the slot's readings until three slots show it."""
        return max(self.rho, 1e-12) if self.slots > 3 else max(self.variance, reading.variance)

    @property
    def unit(self) -> float:
        """What noise is measured in, °C: a step, or the noise of a slot where that is larger."""
        return max(self.step, math.sqrt(self.rho), 1e-4)

    @property
    def reading_sd(self) -> float:
        """Standard deviation of a single reading, °C; NaN before the first slot."""
        if not self.slots:
            return math.nan
        return self.step / math.sqrt(12.0) if self.finder.unknown else max(self.unit, math.sqrt(self.scatter))

    @property
    def repeat_s(self) -> float:
        """How long a reading is repeated: the least time between changes; 0 unless noise or leaps show it."""
        return min(self.interval_s, MOST_REPEAT_S) if self.repeats else 0.0

    def independent(self, reading: Reading) -> float:
        """Return how many independent readings a slot has (von Neumann's ratio), 1 at least."""
        share = (
            self.squared_differences / self.squared_if_independent
            if self.squared_if_independent > 0.0
            else 1.0
        )
        return min(max(share * reading.count, 1.0), reading.count)

    def fresh(self, reading: Reading) -> Reading | None:
        """Return the part of a slot that was not measured before; None where it repeats the last reading.

        A reading repeated for longer than a slot counts once: when it changes, or when that is overdue.
        """
        if self.repeat_s < 0.9 * SLOT_S:
            return reading
        changed = reading.changes > 0 or reading.jumped
        if not changed and reading.end_s - self.fresh_s < self.repeat_s + SLOT_S:
            return None
        return reading.newest(self.repeat_s)

    def is_dead(self, now_s: float) -> bool:
        """Return whether noise of more than a step has stopped for a minute and ten usual intervals."""
        silent_s = now_s - self.changed_s
        noise = self.rho if self.repeats else self.scatter  # from one repeat to the next a ramp scatters, too
        return noise > self.step**2 and silent_s > max(60.0, 10.0 * self.usual_s)

    def begin(self) -> None:
        """Begin a segment; what is known of the sensor stays."""
        self.means, self.change, self.changed_s, self.fresh_s = (), 0.0, math.nan, -math.inf

    def learn(self, reading: Reading) -> Reading | None:
        """Learn from a slot that has readings; return what is `fresh` of it."""
        fresh = self.fresh(reading)
        self.slots += 1
        if fresh is not None:
            self.means = (*self.means[-2:], fresh.mean)
            self.fresh_s = fresh.end_s
        changed = reading.changes > 0 or reading.jumped
        if changed:
            self.finder.learn(reading)
        if fresh is not None and len(self.means) == 3:
            self._learn_rho(*self.means)
        if changed:
            self._learn_changes(reading)
        elif not math.isfinite(self.changed_s):
            self.changed_s = reading.time_s
        return fresh

    def _learn_rho(self, first: float, second: float, third: float) -> None:
        bend = (first - 2.0 * second + third) ** 2 / 6.0
        known = self.variance if self.slots > 8 else COARSEST_DEGC**2
        self.rho += max(MEMORY, 1.0 / max(self.slots - 2, 1)) * (min(bend, OUTLIER * known) - self.rho)

    def _learn_changes(self, reading: Reading) -> None:
        apart = self.means[-1] - self.means[-2] if len(self.means) > 1 else 0.0
        variance = reading.variance + 0.5 * apart**2
        known = max(self.scatter, self.step**2 / 4.0) if self.changed_slots else COARSEST_DEGC**2
        if variance < OUTLIER * known:
            self.changed_slots += 1
            weight = max(MEMORY, 1.0 / self.changed_slots)
            self.scatter += weight * (variance - self.scatter)
            self.squared_differences += weight * (reading.step_squares - self.squared_differences)
            self.squared_if_independent += weight * (
                2.0 * reading.count * variance - self.squared_if_independent
            )
        self._learn_interval(reading)

    def _learn_interval(self, reading: Reading) -> None:
        change = reading.last - (reading.before if math.isfinite(reading.before) else reading.first)
        single = reading.changes <= 1
        silent_s = reading.time_s - self.changed_s if self.change else math.nan
        back = change * self.change < 0.0 and silent_s < FLICKER_S
        # A level that is read once in a hundred times shows no edge: its noise could be of any size.
        shared = min(reading.mean - reading.low, reading.high - reading.mean) > 0.1 * self.step
        self.reversals += (reading.changes > 1 or back) and (shared or reading.low == reading.high)
        possible = 1.5 * self.step < abs(change) < FASTEST_RATE * silent_s
        self.leaps += single and possible and silent_s > 2.0 * SLOT_S
        gap_s = silent_s if single else SLOT_S / reading.changes
        if math.isfinite(gap_s):
            longest = 1.01 * max(self.interval_s, reading.gap_s)
            self.interval_s = min(gap_s, longest) if self.interval_s else gap_s
        if math.isfinite(silent_s):
            self.usual_s += (MEMORY if self.usual_s else 1.0) * (silent_s - self.usual_s)
        shown = self.reversals >= REVERSALS or self.leaps > 0
        self.repeats = shown and self.interval_s > 1.5 * reading.gap_s
        self.change, self.changed_s = change, reading.time_s
