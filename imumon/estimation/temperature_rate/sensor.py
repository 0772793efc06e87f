"""What the readings of a slot are, and what is learned of the sensor from slot to slot."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from imumon.estimation.temperature_rate.step import StepFinder

MEMORY = 1.0 / 32.0
"""Weight of a new slot in what is learned, after as many slots."""
MOST = 9.0
"""A slot counts in a variance with no more than so many times what is known: a spike spoils little."""
DEAD_S, DEAD_INTERVALS = 60.0, 10.0
"""Noise of more than a step that stops for so long, and so many usual intervals, is a dead sensor."""
SLOWER = 1.01
"""Factor by which the interval between changes grows with each change that comes later."""
MOST_INDEPENDENT = 32.0
"""More readings would place an edge, σ/√n, finer than its sigma is known between two of the bank's."""
SLOW_S, LEAPS = 1.5, 2
"""A reading that changes no faster than this and by more than a step, so many times, is refreshed slowly."""
DITHERED = 0.2
"""White noise of so many steps within a slot makes its mean nearly linear in the temperature."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The readings of one thermometer in one slot.

    Parameters
    ----------
    start_s, end_s : float
        First and last sample, s since the segment began.
    count : int
        Readings; all below is NaN or zero without any.
    mean, variance, low, high, first, last : float
        °C, °C².
    changes : int
        How many readings differ from the one before.
    step_squares : float
        Sum of squared differences of neighbours, °C².
    before : float
        Last reading of the slot before; NaN if that is long ago.
    gap_s : float
        Time between two readings.
    """

    start_s: float
    end_s: float
    count: int
    mean: float
    variance: float
    low: float
    high: float
    first: float
    last: float
    changes: int
    step_squares: float
    before: float
    gap_s: float

    @property
    def newest(self) -> Reading:
        """The last of the readings alone."""
        return replace(
            self, start_s=self.end_s, mean=self.last, variance=0.0, low=self.last, high=self.last,
            first=self.last, changes=0, step_squares=0.0, before=np.nan,
        )  # fmt: skip

    @property
    def time_s(self) -> float:
        """Middle."""
        return 0.5 * (self.start_s + self.end_s)

    @property
    def differences(self) -> tuple[float, ...]:
        """Differences of readings, which tell the step of the sensor, °C."""
        single = (float(np.sqrt(self.step_squares)),) if self.changes == 1 else ()
        return (*single, self.first - self.before, self.high - self.low)

    @property
    def duration_s(self) -> float:
        """Length."""
        return self.end_s - self.start_s


@dataclass(slots=True)
class Sensor:
    """What has been learned of a thermometer.

    Parameters
    ----------
    finder : StepFinder
    inside : float
        Variance of the readings about their short-term mean, °C².
    roughness : float
        Variance of a slot's mean as seen from three neighbouring slots, °C².
    squares, spread : float
        Squared differences of neighbours in a slot, and what they would be if all readings were independent:
        less where readings are repeated or correlated, °C².
    interval_s : float
        Time within which the reading does not change twice: the refresh interval or more.
    usual_s : float
        Usual time between slots that change.
    changed_s : float
        When the reading changed last.
    leaps : int
        Single changes by more than a step while the reading hardly ever changes: slow refreshes.
    learned : int
        Slots that changed.
    slots : int
    means : tuple
        Means of the last slots, °C.
    """

    finder: StepFinder
    inside: float = 0.0
    roughness: float = 0.0
    squares: float = 0.0
    spread: float = 0.0
    interval_s: float = 0.0
    usual_s: float = 0.0
    changed_s: float = float("nan")
    leaps: int = 0
    learned: int = 0
    slots: int = 0
    means: tuple[float, ...] = field(default=())

    @property
    def step(self) -> float:
        """The quantization step in °C as far as it is known, 0 when there is none."""
        return 0.0 if self.finder.stepless else self.finder.size

    @property
    def unit(self) -> float:
        """What the sensor's noise is measured in, °C: a step, or the noise of a slot where that is larger."""
        return max(self.step, float(np.sqrt(self.roughness)), 1e-4)

    def independent(self, reading: Reading) -> float:
        """Return how many independent readings a slot has; less than one where a reading outlasts it."""
        share = self.squares / self.spread if self.spread > 0.0 else 1.0
        count = min(max(share * reading.count, 1.0), MOST_INDEPENDENT)
        slow = 1.0 if self.refreshes_slowly else self.interval_s / max(reading.duration_s, reading.gap_s)
        return min(count, reading.count) / max(slow, 1.0)

    @property
    def refreshes_slowly(self) -> bool:
        """Whether a reading is repeated over slots until there is another."""
        return self.leaps >= LEAPS and self.interval_s > SLOW_S

    def is_old(self, reading: Reading) -> bool:
        """Tell whether a reading is still that of the last refresh."""
        old = not reading.changes and reading.time_s - self.changed_s < 1.5 * self.interval_s
        return self.refreshes_slowly and old

    def is_dead(self, now_s: float) -> bool:
        """Tell whether noise of more than a step has stopped."""
        silent = now_s - self.changed_s
        return self.inside > self.step**2 and silent > max(DEAD_S, DEAD_INTERVALS * self.usual_s)

    def linear(self, reading: Reading) -> float:
        """Return the temperature that a dithered slot shows, the quantizer's ripple taken off.

        White noise of s steps leaves E[reading] = x - β/π sin 2πx, β = exp(-2π²s²), x in steps; the variance
        of the readings gives s (first harmonic of the rounding error, Widrow and Kollar 2008, ch. 4).
        """
        step = self.step
        if not step or reading.changes < 4 or self.independent(reading) < 4.0:
            return reading.mean
        z, variance = reading.mean / step, self.inside / step**2
        x, beta = z, 0.0
        for _ in range(4):
            cosine = beta * np.cos(2.0 * np.pi * x)
            rest = variance - 1.0 / 12.0 + cosine / np.pi**2 + (beta / np.pi * np.sin(2.0 * np.pi * x)) ** 2
            square = max(rest / max(1.0 - 4.0 * cosine, 0.2), DITHERED**2)
            beta = float(np.exp(-2.0 * np.pi**2 * square))
            x = z + beta / np.pi * float(np.sin(2.0 * np.pi * x))
        return step * x

    def learn(self, reading: Reading) -> None:
        """Learn from a slot that has readings."""
        self.slots += 1
        if not self.refreshes_slowly:
            self._learn_roughness(reading.mean)
        elif reading.changes:
            self._learn_roughness(reading.last)
        if not reading.changes:
            return
        self._learn_changes(reading)
        self.finder.learn(reading.differences)

    def _learn_roughness(self, mean: float) -> None:
        self.means = (*self.means[-2:], mean)
        if len(self.means) < 3:
            return
        bend = (self.means[0] - 2.0 * self.means[1] + self.means[2]) ** 2 / 6.0
        if self.slots > 8:
            bend = min(bend, MOST * max(self.roughness, self.step**2 / 12.0, 1e-10))
        self.roughness += max(MEMORY, 1.0 / max(self.slots - 2, 1)) * (bend - self.roughness)

    def _learn_changes(self, reading: Reading) -> None:
        self.learned += 1
        weight = max(MEMORY, 1.0 / self.learned)
        apart = self.means[-1] - self.means[-2] if len(self.means) > 1 else 0.0
        variance = reading.variance + 0.5 * apart**2
        known = MOST * max(self.inside, self.step**2 / 4.0)
        if self.learned == 1 or variance < known:
            self.inside += weight * (variance - self.inside)
            self.squares += weight * (reading.step_squares - self.squares)
            self.spread += weight * (2.0 * reading.count * variance - self.spread)
        since = (
            reading.duration_s / reading.changes if reading.changes > 1 else reading.time_s - self.changed_s
        )
        if self.learned > 1 or reading.changes > 1:
            longest = SLOWER * max(self.interval_s, reading.gap_s) if self.interval_s else since
            self.interval_s = min(since, longest)
        leap = np.sqrt(reading.step_squares) > 1.5 * self.step and self.interval_s > SLOW_S
        if self.step and reading.changes == 1 and leap:
            self.leaps += 1
            if self.leaps == LEAPS:
                # What looked like noise from slot to slot were the refreshes.
                self.roughness, self.means = self.step**2 / 12.0, ()
        if self.learned > 1:
            self.usual_s += weight * (reading.time_s - self.changed_s - self.usual_s)
        self.changed_s = reading.time_s
