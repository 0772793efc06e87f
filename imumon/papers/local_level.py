"""Where the filters of model L and NL begin: level, R and δ¹ of a local level, by likelihood.

They run at every sample; where they begin, and with which noise, is found from means of a second at rest.

Model NL does not learn δ¹ and δ²: their covariance with x is zero and stays so.  They are fitted here
instead.  With φ = 0 and δ² = 0 model L is a random walk measured with white noise: δ¹ = √(walk Δt) and
R = white / Δt.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.slots import Slots

SLOT_S = 1.0
LEAST_S = 0.5
"""A slot with the unit at rest for less than this is not believed: the motion may have begun in it."""
LEAST_MEANS = 30
RATIOS = 10.0 ** np.arange(-11.0, 1.01, 0.05)[60:]
"""Walks that are tried, over the white noise's density, 1/s²: from 1e-8 on, as within a day a smaller walk
cannot be distinguished from none."""
FLOOR = 1e-24
"""(rad/s)² s: white noise below 1e-12 rad/s/√Hz is none; keeps a constant reading from dividing by zero."""
TO_INSTABILITY = math.sqrt(math.pi / math.log(10.0))
"""Bias instability B (IEEE Std 952: the Allan floor is 0.664 B) of flicker with unit variance per decade."""


class RestMean(NamedTuple):
    """One second of one axis."""

    begins: bool  # whether a segment begins here
    elapsed_s: float  # from the middle of the last slot to the middle of this one
    covered_s: float  # time at rest with readings; 0 where the slot has none
    mean: float  # rad/s; NaN where the slot has no readings
    interval_s: float  # between samples


class RestMeans:
    """Turns slots of readings that are NaN except at rest into means, whatever the division into blocks."""

    def __init__(self) -> None:
        self._middle_ns, self._interval_s = 0, 0.0

    def process(self, slots: Slots) -> list[list[RestMean]]:
        """Return for each slot the mean of each column."""
        found = []
        for k in range(len(slots)):
            middle_ns, begins = slots.middle_ns[k], slots.begins[k]
            elapsed = SLOT_S if begins else (middle_ns - self._middle_ns) * 1e-9
            samples = slots.samples[k]
            inside = (slots.end_ns[k] - slots.start_ns[k]) * 1e-9
            if samples > 1:
                self._interval_s = inside / (samples - 1)
            interval = self._interval_s or elapsed  # of a stream with a sample in each slot
            row = []
            for count, mean in zip(slots.count[k], slots.mean[k], strict=True):
                covered = float(count) * interval
                known = (covered, float(mean)) if covered >= LEAST_S else (0.0, math.nan)
                row.append(RestMean(begins, elapsed, *known, interval))
            found.append(row)
            self._middle_ns = middle_ns
        return found


@dataclass
class ExponentialMean:
    """Mean with exponentially fading memory; over what there is until that is as long as the memory."""

    time_constant_s: float  # s at rest; infinity for the mean of everything
    longest_s: float = math.inf  # s at rest after which the mean is held
    rest_s: float = 0.0
    mean: float = math.nan

    def step(self, new: RestMean) -> float:
        """Take in a second; return the mean, NaN before the first reading of a segment."""
        if new.begins:
            self.rest_s, self.mean = 0.0, math.nan
        if new.covered_s > 0.0 and self.rest_s < self.longest_s:
            self.rest_s += new.covered_s
            gain = max(new.covered_s / self.rest_s, -math.expm1(-new.covered_s / self.time_constant_s))
            before = new.mean if math.isnan(self.mean) else self.mean
            self.mean = before + gain * (new.mean - before)
        return self.mean


class LocalLevel(NamedTuple):
    """Noise of a local level: of samples Δt apart, R = white / Δt and q = δ¹² = walk Δt."""

    white: float  # density of the white noise, (rad/s)² s
    walk: float  # (rad/s)²/s


def fit_local_level(means: Sequence[RestMean]) -> LocalLevel:
    """Fit white noise and random walk by likelihood, to at least `LEAST_MEANS` means with readings.

    The mean over the logarithm of the walk, weighted by the likelihood: never without a walk, for without
    process noise the covariance of the filters degenerates.
    """
    deviance, white, *_ = filtered(means, RATIOS)
    weights = np.exp(-0.5 * (deviance - deviance.min()))
    weights /= weights.sum()
    mean_white = weights @ white
    return LocalLevel(mean_white, math.exp(weights @ np.log(RATIOS)) * mean_white)


def filtered(means: Sequence[RestMean], ratios: FloatArray) -> FloatArray:
    """Run a Kalman filter of the level for each ratio walk / white, all in units of the white noise.

    Return -2 log likelihood, the white noise's density at its best, and after the last mean the level and its
    variance over that density, infinite without a reading, (4, g).
    """
    level, variance = np.zeros(len(ratios)), np.full(len(ratios), np.inf)
    logs, squares, count = np.zeros(len(ratios)), np.zeros(len(ratios)), 0
    for new in means:
        if new.begins:
            variance[:] = np.inf
        variance = variance + ratios * new.elapsed_s
        if not new.covered_s > 0.0:
            continue
        noise = 1.0 / new.covered_s
        if np.isinf(variance[0]):
            level[:], variance[:] = new.mean, noise
            continue
        total, innovation = variance + noise, new.mean - level
        logs += np.log(total)
        squares += innovation**2 / total
        count += 1
        level += variance / total * innovation
        variance = variance * noise / total
    white = squares / max(count, 1) + FLOOR
    return np.array([count * np.log(white) + logs, white, level, variance])


def level_after(means: Sequence[RestMean], noise: LocalLevel) -> tuple[float, float]:
    """Return the level after the last mean of a segment and its variance."""
    *_, level, variance = filtered(means, np.array([noise.walk / noise.white]))[:, 0].tolist()
    return level, noise.white * variance


def from_noise(
    angle_random_walk: float, bias_instability: float | None, rate_random_walk: float | None
) -> LocalLevel:
    """Return the local level that has the least error where the noise is known, rad/√s, rad/s and rad/s/√s.

    A mean over T has the error 1/(2T) + h ln T + walk T/2 and a constant, h the flicker per e-fold, in units
    of the white noise; its least is at 1/T = h + √(h² + walk), and the filter that averages over T has the
    walk 1/T².
    """
    white = angle_random_walk**2
    flicker = ((bias_instability or 0.0) / TO_INSTABILITY) ** 2 / white / math.log(10.0)
    walk = (rate_random_walk or 0.0) ** 2 / white
    return LocalLevel(white, (flicker + math.sqrt(flicker**2 + walk)) ** 2 * white)
