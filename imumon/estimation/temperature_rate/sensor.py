"""What the readings of a slot are, and what is learned of the sensor from slot to slot."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from imumon.estimation.temperature_rate.bank import SLOT_S, Slow, slow_errors
from imumon.estimation.temperature_rate.refresh import FASTEST, RefreshFinder
from imumon.estimation.temperature_rate.step import COARSEST, StepFinder

MEMORY = 1.0 / 32.0
"""Weight of a new slot in what is learned, after as many slots."""
FLICKER_S, FLICKERS = 10.0, 3
"""So often a reading has to go back within this time to be known to flicker."""
EDGES, STICKY_EDGES = 0.05, 0.5
"""Edges between levels are known to so many steps: ±0.1 of nonlinearity is a good converter's; hysteresis
of a step is half a step either way."""
MOST = 9.0
"""A slot counts in a variance with no more than so many times what is known: a spike spoils little."""
LEAP = 8.0
"""Readings of a slot that lie farther apart than so many steps or deviations are no noise."""
DEAD_S, DEAD_INTERVALS = 60.0, 10.0
"""Noise of more than a step that stops for so long, and so many usual intervals, is a dead sensor."""
SLOWER = 1.01
"""Factor by which the interval between changes grows with each change that comes later."""
TINY_S = 1e-9
"""Times of samples are in ns, and may be equal."""
MOST_INDEPENDENT = 32.0
"""More readings would place an edge, σ/√n, finer than its sigma is known between two of the bank's."""
DITHERED = 0.2
"""White noise of so many steps within a slot makes its mean nearly linear in the temperature."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The readings of one thermometer in one slot."""

    start_s: float
    end_s: float
    """First and last sample, s since the segment began."""
    count: int
    """Readings; all below is NaN or zero without any."""
    mean: float
    variance: float
    low: float
    high: float
    first: float
    last: float
    """°C, °C²."""
    changes: int
    """How many readings differ from the one before."""
    step_squares: float
    """Sum of squared differences of neighbours, °C²."""
    before: float
    """Last reading of the slot before; NaN if that is long ago."""
    gap_s: float
    """Time between two readings."""

    def newest(self, time_s: float, gap_s: float) -> Reading:
        """Return the last of the readings alone, taken at a time, so long after the one before."""
        before = self.before if math.isfinite(self.before) else self.first
        return replace(
            self, start_s=time_s, end_s=time_s, count=1, mean=self.last, variance=0.0, low=self.last,
            high=self.last, first=self.last, changes=int(before != self.last), step_squares=0.0,
            before=before, gap_s=gap_s,
        )  # fmt: skip

    @property
    def changed_s(self) -> float:
        """When the last reading came, if it is the only one that differs; else the end of the slot."""
        if self.changes != 1 or self.first == self.last:
            return self.start_s if self.changes == 1 else self.end_s
        share = (self.last - self.mean) / (self.last - self.first)
        return self.start_s + round(share * self.count) * self.gap_s

    @property
    def time_s(self) -> float:
        """Middle."""
        return 0.5 * (self.start_s + self.end_s)

    @property
    def differences(self) -> tuple[float, ...]:
        """Differences of readings, which tell the step of the sensor, °C."""
        single = (math.sqrt(self.step_squares),) if self.changes == 1 else ()
        return (*single, self.first - self.before, self.high - self.low)

    @property
    def duration_s(self) -> float:
        """Length."""
        return self.end_s - self.start_s


@dataclass(slots=True)
class Sensor:
    """What has been learned of a thermometer."""

    finder: StepFinder
    step: float = field(init=False)
    """The quantization step in °C as far as it is known, 0 when there is none."""
    inside: float = 0.0
    """Variance of the readings about their short-term mean, °C²."""
    roughness: float = 0.0
    """Variance of a slot's mean as seen from three neighbouring slots, °C²."""
    dither: float = DITHERED**2
    """Variance of white noise before the quantizer, steps²."""
    squares: float = 0.0
    spread: float = 0.0
    """Squared differences of neighbours in a slot, and what they would be if all readings were
    independent: less where readings are repeated or correlated, °C²."""
    interval_s: float = 0.0
    """Time within which the reading does not change twice: the refresh interval or more."""
    usual_s: float = 0.0
    """Usual time between slots that change."""
    changed_s: float = float("nan")
    change: float = 0.0
    """When the reading changed last, and by how much, °C."""
    refresh: RefreshFinder = field(default_factory=RefreshFinder)
    """When a reading that is repeated over slots is a new one."""
    learned: int = 0
    reversed: int = 0
    """Slots that changed; and those in which a reading went back within `FLICKER_S`."""
    slots: int = 0
    means: tuple[float, ...] = field(default=())
    """Means of the last slots, °C."""

    def __post_init__(self) -> None:
        """Begin with the step that the finder begins with."""
        self.step = self.finder.size

    @property
    def unit(self) -> float:
        """What the sensor's noise is measured in, °C: a step, or the noise of a slot where that is larger."""
        return max(self.step, math.sqrt(self.roughness), 1e-4)

    @property
    def slow_errors(self) -> Slow:
        """The bank's slow errors."""
        roughness = max(self.roughness, self.step**2 / 12.0)
        return slow_errors(self.unit, roughness, self.refresh.interval_s if self.refresh.slow else SLOT_S)

    @property
    def edges(self) -> float:
        """How well the edges between levels are known, °C.

        A converter with hysteresis follows only when it is off by a step or so; one that flickers has none.
        """
        return (EDGES if self.reversed >= FLICKERS else STICKY_EDGES) * self.step

    @property
    def hidden(self) -> float:
        """How far off the temperature may be behind a level, °C: the coarsest's where no step was seen."""
        return COARSEST / math.sqrt(12.0) if self.finder.unseen else self.edges

    @property
    def scatter(self) -> float:
        """Standard deviation of a single reading, °C; NaN before the first slot, as nothing tells it."""
        return max(self.unit, math.sqrt(self.inside), self.hidden) if self.slots else math.nan

    def independent(self, reading: Reading) -> float:
        """Return how many independent readings a slot has; less than one where a reading outlasts it."""
        share = self.squares / self.spread if self.spread > 0.0 else 1.0
        count = min(max(share * reading.count, 1.0), MOST_INDEPENDENT)
        slow = 1.0 if self.refresh.slow else self.interval_s / max(reading.duration_s, reading.gap_s, TINY_S)
        return min(count, reading.count) / max(slow, 1.0)

    def fresh(self, reading: Reading) -> Reading | None:
        """Return what a slot has that was not there before, None where it repeats the last reading."""
        if not self.refresh.slow:
            return reading
        at = (
            reading.changed_s
            if reading.changes
            else self.refresh.refreshed(reading.start_s - reading.gap_s, reading.end_s)
        )
        return None if at is None else reading.newest(at, self.refresh.interval_s)

    def leaps(self, reading: Reading) -> bool:
        """Tell whether a slot spans more than any thermometer's noise and steps: there is a fault in it."""
        return reading.high - reading.low > LEAP * max(self.step, COARSEST, math.sqrt(self.inside))

    def moves(self, reading: Reading) -> float:
        """Return how far readings of neighbouring slots may lie apart, °C."""
        noise = LEAP * max(self.step, math.sqrt(self.inside + self.roughness))
        return max(noise, FASTEST * (SLOT_S + max(reading.duration_s, reading.gap_s)))

    def is_dead(self, now_s: float) -> bool:
        """Tell whether noise of more than a step has stopped."""
        silent = now_s - self.changed_s
        # From one slow refresh to the next a ramp scatters the readings as well.
        noise2 = self.roughness if self.refresh.slow else self.inside
        return noise2 > self.step**2 and silent > max(DEAD_S, DEAD_INTERVALS * self.usual_s)

    def linear(self, reading: Reading) -> float:
        """Return the temperature that a dithered slot shows, the quantizer's ripple taken off.

        White noise of s steps leaves E[reading] = x - β/π sin 2πx, β = exp(-2π²s²), x in steps from a level
        (first harmonic of the rounding error, Widrow and Kollar 2008, ch. 4).
        """
        if not self._dithers(reading):
            return reading.mean
        return reading.low + self.step * _undithered((reading.mean - reading.low) / self.step, self.dither)

    def _dithers(self, reading: Reading) -> bool:
        return self.step > 0.0 and reading.changes >= 4 and self.independent(reading) >= 4.0

    def _learn_dither(self, reading: Reading, weight: float) -> None:
        """Learn s² from the variance of the readings, 1/12 + s² - c (1/π² + 4 s²) - d²/π².

        c and d are β cos 2πx and β sin 2πx: the place x matters, as a slow temperature stays at one.
        """
        x = _undithered((reading.mean - reading.low) / self.step, self.dither)
        beta = math.exp(-2.0 * math.pi**2 * self.dither)
        cosine, sine = beta * math.cos(2.0 * math.pi * x), beta * math.sin(2.0 * math.pi * x)
        rest = reading.variance / self.step**2 - 1.0 / 12.0 + cosine / math.pi**2 + (sine / math.pi) ** 2
        square = max(rest / max(1.0 - 4.0 * cosine, 0.2), DITHERED**2)
        self.dither += weight * (min(square, MOST * self.dither) - self.dither)

    def learn(self, reading: Reading) -> None:
        """Learn from a slot that has readings."""
        slow = self.refresh.slow
        if reading.changes:
            self._learn_refresh(reading)
        if self.refresh.slow and not slow:
            # What looked like noise from slot to slot were the refreshes.
            self.roughness, self.means, self.slots = self.step**2 / 12.0, (), 0
        fresh = self.fresh(reading)
        if fresh is not None:
            self.slots += 1
            self._learn_roughness(fresh.mean)
        if reading.changes:
            self._learn_changes(reading)
            self.finder.learn(reading.differences)
            self.step = 0.0 if self.finder.stepless else self.finder.size

    def _learn_refresh(self, reading: Reading) -> None:
        if reading.changes > 1:
            self.refresh.refute()
            return
        before = reading.before if math.isfinite(reading.before) else reading.first
        silent_s = reading.changed_s - self.changed_s
        if self.interval_s:
            silent_s = min(silent_s, self.interval_s)
        self.refresh.learn(reading.changed_s, reading.last - before, silent_s, self.step, reading.gap_s)

    def _learn_roughness(self, mean: float) -> None:
        self.means = (*self.means[-2:], mean)
        if len(self.means) < 3:
            return
        bend = (self.means[0] - 2.0 * self.means[1] + self.means[2]) ** 2 / 6.0
        known = max(self.roughness, self.step**2 / 12.0, 1e-10) if self.slots > 8 else COARSEST**2
        bend = min(bend, MOST * known)
        self.roughness += max(MEMORY, 1.0 / max(self.slots - 2, 1)) * (bend - self.roughness)

    def _learn_changes(self, reading: Reading) -> None:
        apart = self.means[-1] - self.means[-2] if len(self.means) > 1 else 0.0
        variance = reading.variance + 0.5 * apart**2
        known = MOST * (max(self.inside, self.step**2 / 4.0) if self.learned else COARSEST**2)
        if variance > known and not self.learned:
            return  # a fault: the noise of no thermometer begins so
        self.learned += 1
        weight = max(MEMORY, 1.0 / self.learned)
        if variance < known:
            self.inside += weight * (variance - self.inside)
            self.squares += weight * (reading.step_squares - self.squares)
            self.spread += weight * (2.0 * reading.count * variance - self.spread)
            if self._dithers(reading):
                self._learn_dither(reading, weight)
        gap_s = reading.changed_s - self.changed_s
        change = reading.last - (reading.before if math.isfinite(reading.before) else reading.first)
        self.reversed += reading.changes > 1 or (change * self.change < 0.0 and gap_s < FLICKER_S)
        self.change = change
        since = reading.duration_s / reading.changes if reading.changes > 1 else gap_s
        known = self.learned > 1 and math.isfinite(gap_s)  # not where a segment begins
        if known or reading.changes > 1:
            longest = SLOWER * max(self.interval_s, reading.gap_s) if self.interval_s else since
            self.interval_s = min(since, longest)
        if known:
            self.usual_s += weight * (gap_s - self.usual_s)
        self.changed_s = reading.changed_s


def _undithered(z: float, square: float) -> float:
    """Return the x whose dithered readings have the mean z, in steps, with noise of this variance, steps²."""
    beta, x = math.exp(-2.0 * math.pi**2 * square), z
    for _ in range(4):
        x = z + beta / math.pi * math.sin(2.0 * math.pi * x)
    return x
