"""What the readings of a slot say: one decision table, evaluated top down, for all filters at once.

Level kinds, d the step, s² = σ² + (r² + P_rr) (1 s)²/12 with the motion within the slot:

| the slot, with the last reading before it | for which filters | what enters |
|---|---|---|
| more than two levels | all | z = mean less its ripple, R = max(s², variance)/(n slope²) + (β d/π)²/8 |
| more than two levels, by one reading | all | as one level |
| two levels, the later by one reading | its edge is soft | as one level |
| two levels | all others | z = edge + s Φ⁻¹(p), R = s² p(1-p)/(k φ²), p the share above the edge |
| one level | its edge is soft, or it is news | T + e is in the level: truncated Gaussian |
| one level | all others | nothing; the level only confines what is shown |

Mean kinds take the mean of any slot as z, with R = white share of ρ, and the lattice of means, (d/n)²/12.

"Inside the level" is one statement however often it is read.  Where the edge is softer than the prediction
(√P_y < 2 s), readings are independent evidence; where it is sharp, only a contradiction is new.

Log likelihoods are probabilities of a slot's mean on its lattice of d/n, so that all rows can be compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from imumon.blocks import BoolArray, FloatArray
from imumon.estimation.temperature_rate.model import ERROR, SLOT_S, TEMPERATURE, Params
from imumon.estimation.temperature_rate.sensor import Reading, Thermometer
from imumon.filters.multiple_models import LEAST_LOG_LIKELIHOOD

ROOT_2_PI = math.sqrt(2.0 * math.pi)


class Predicted(NamedTuple):
    """The reading y = H x, H = [1, 0, 0, 1], as every filter predicts it, (k, m)."""

    mean: FloatArray
    variance: FloatArray
    gain: FloatArray
    """P Hᵀ / (H P Hᵀ), (4, k, m): how the state follows y."""

    def rows(self, kinds: slice) -> Predicted:
        """Return the prediction of some kinds."""
        return Predicted(self.mean[kinds], self.variance[kinds], self.gain[:, kinds])


def predicted_reading(x: FloatArray, p: FloatArray) -> Predicted:
    """Return the prediction of the reading before its white noise and steps."""
    cross = p[:, TEMPERATURE] + p[:, ERROR]
    variance = cross[TEMPERATURE] + cross[ERROR]
    return Predicted(x[TEMPERATURE] + x[ERROR], variance, cross / variance)


@dataclass(slots=True)
class Evidence:
    """What a slot says of y: how its mean and variance change, and the log likelihood, (k, m) each."""

    shift: FloatArray
    growth: FloatArray
    """Change of the variance, at most zero, °C²."""
    log_likelihood: FloatArray
    level: Level | None = None
    """The level that the readings stay on, of the level kinds."""


class Level(NamedTuple):
    """What "y is in the level" would change, (levels, m); `enters` where it entered the state."""

    enters: BoolArray
    is_soft: BoolArray
    shift: FloatArray
    growth: FloatArray
    log_mass: FloatArray


Part = tuple[FloatArray, FloatArray, FloatArray]
"""Shift, growth and log likelihood of some kinds."""


def evaluate(
    params: Params,
    thermometer: Thermometer,
    reading: Reading,
    y: Predicted,
    motion: FloatArray,
    mu: FloatArray,
) -> Evidence:
    """Return what a slot with readings says to every filter: the table above.

    Parameters
    ----------
    y : Predicted
        The reading as predicted for the middle of the slot.
    motion : array, (k, m)
        Mean square of the rate, r² + P_rr, (°C/s)².
    mu : array, (k, m)
        Mode probabilities.
    """
    levels, means = y.rows(slice(0, params.kinds.levels)), y.rows(slice(params.kinds.levels, None))
    slot = _Slot(params, thermometer, reading, mu, thermometer.independent(reading))
    moved = motion[: params.kinds.levels] * slot.duration_s**2 / 12.0
    sigma = np.sqrt((slot.white * slot.step) ** 2 + moved)
    of_levels, level = _levels(slot, levels, sigma)
    of_means = _mean(slot, means)
    shift, growth, log = (np.concatenate(pair) for pair in zip(of_levels, of_means, strict=True))
    return Evidence(shift, growth, log, level)


def _levels(slot: _Slot, y: Predicted, sigma: FloatArray) -> tuple[Part, Level | None]:
    """Return what level kinds take from a slot, and the level that its readings stay on."""
    span = (slot.high - slot.low) / slot.step
    single = slot.reading.count == 1
    if span > 1.5 and not single:
        return _many_levels(slot, y, sigma), None
    if span < 0.5 or span > 1.5:
        level = _one_level(slot, y, sigma)
        return _entered(slot, level), level
    two = _two_levels(slot, y, sigma)
    if not single:
        return two, None
    # Of one reading a filter that is sharper than the noise takes the level, not the edge before it.
    one = _one_level(slot, y, sigma)
    pairs = zip((one.shift, one.growth, one.log_mass), two, strict=True)
    shift, growth, log = (np.where(one.is_soft, alone, both) for alone, both in pairs)
    return (shift, growth, log), None


@dataclass(frozen=True, slots=True)
class _Slot:
    """A slot with what all rows of the table need of it."""

    params: Params
    thermometer: Thermometer
    reading: Reading
    mu: FloatArray
    """Mode probabilities before the slot, (k, m)."""
    n: float
    """Independent readings, 1 at least."""

    @property
    def step(self) -> float:
        return self.thermometer.step

    @property
    def white(self) -> FloatArray:
        """White noise of the level kinds, steps, (levels, 1)."""
        return self.params.kinds.white[: self.params.kinds.levels]

    @property
    def duration_s(self) -> float:
        """Time that the readings, with the last one before them, are spread over, s."""
        return max(SLOT_S, self.reading.gap_s)

    @property
    def cell(self) -> float:
        """Distance between the values that the mean can have, °C."""
        return max(self.step / self.n, 1e-6)

    @property
    def low(self) -> float:
        """Lowest reading, with that before the slot."""
        reading = self.reading
        return min(reading.low, reading.before) if reading.jumped else reading.low

    @property
    def high(self) -> float:
        """Highest reading, with that before the slot."""
        reading = self.reading
        return max(reading.high, reading.before) if reading.jumped else reading.high


def _gaussian(
    y: Predicted, z: FloatArray | float, noise: FloatArray, unit: FloatArray | float, smear: float = 0.0
) -> Part:
    """Correct by y = z with the variance R: v² / S; `unit` turns the density of z into a probability.

    `smear` is added to S in the likelihood alone: a cell as a Gaussian of the same height, so that no
    probability exceeds 1.
    """
    total = y.variance + noise
    innovation = z - y.mean
    shift, growth = y.variance * innovation / total, -(y.variance**2) / total
    total = total + smear
    log = np.log(unit / ROOT_2_PI) - 0.5 * np.log(total) - 0.5 * innovation**2 / total
    return shift, growth, log


def _mean(slot: _Slot, y: Predicted) -> Part:
    share = slot.params.kinds.white[slot.params.kinds.levels :]
    white = share * slot.thermometer.mean_variance(slot.reading)
    cell = slot.cell
    shift, growth, log = _gaussian(
        y, slot.reading.mean, white + cell**2 / 12.0, cell, cell**2 / (2.0 * math.pi)
    )
    return shift, growth, log


def _many_levels(slot: _Slot, y: Predicted, sigma: FloatArray) -> Part:
    ripple = slot.params.kinds.ripple
    offset = (slot.reading.mean - slot.reading.low) / slot.step
    place = np.full_like(ripple, offset)
    for _ in range(4):  # solve mean = x - β/π sin 2πx for x
        place = offset + np.minimum(ripple, 0.4) / math.pi * np.sin(2.0 * math.pi * place)
    # The mean follows x with this slope: 0.4 in the middle of a level for noise of a quarter of a step.
    slope = np.maximum(1.0 - 2.0 * ripple * np.cos(2.0 * math.pi * place), 0.2)
    noise = np.maximum(sigma**2, slot.reading.variance) / slot.n / slope**2
    noise += (ripple * slot.step / math.pi) ** 2 / 8.0
    shift, growth, log = _gaussian(y, slot.reading.low + slot.step * place, noise, slot.cell / slope)
    # Readings that scatter more than a kind's: the likelihood of their variance (χ² of n), zero in the mean.
    excess = np.maximum(slot.reading.variance / _rounded_variance(slot, place, sigma), 1.0)
    return shift, growth, log + 0.25 - 0.5 * slot.n * (excess - 1.0 - np.log(excess))


def _between_levels(slot: _Slot, log: FloatArray) -> FloatArray:
    """Return a log likelihood of which mean kinds say nothing, as evidence between level kinds alone.

    For the mean kinds it is taken to be what it is for the level kinds together: their mean under `mu`.
    """
    mu = slot.mu[: slot.params.kinds.levels]
    log = np.maximum(log - log.max(), LEAST_LOG_LIKELIHOOD)
    return np.asarray(log - math.log((mu * np.exp(log)).sum() / mu.sum()))


def _rounded_variance(slot: _Slot, place: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the variance of readings of noise σ at a place x in steps: σ² + d²/12 and its first harmonic."""
    ripple = slot.params.kinds.ripple
    white = slot.white**2
    cosine, sine = ripple * np.cos(2.0 * math.pi * place), ripple * np.sin(2.0 * math.pi * place)
    harmonic = -cosine * (1.0 / math.pi**2 + 4.0 * white) - (sine / math.pi) ** 2
    return sigma**2 + slot.step**2 * np.maximum(1.0 / 12.0 + harmonic, 0.0)


def _two_levels(slot: _Slot, y: Predicted, sigma: FloatArray) -> Part:
    reading = slot.reading
    count = reading.count + reading.jumped
    total = reading.count * reading.mean + (reading.before if reading.jumped else 0.0)
    share = min(max((total / count - slot.low) / (slot.high - slot.low), 0.5 / count), 1.0 - 0.5 / count)
    edge = 0.5 * (slot.low + slot.high)
    # Independent readings change level 2 k p (1 - p) times; a single crossing changes it once.
    k = min(max(reading.changes / (2.0 * share * (1.0 - share)), 1.0), slot.n)
    quantile = float(ndtri(share))
    density = math.exp(-0.5 * quantile**2) / ROOT_2_PI
    z = edge + sigma * quantile
    noise = sigma**2 * (share * (1.0 - share) / (k * density**2) + (slot.params.spacing * quantile) ** 2)
    unit = sigma / (density * slot.n)
    # All n readings are of these two levels: kinds of more noise would have read a third.
    apart = slot.step / sigma
    within = slot.n * np.log(np.maximum(ndtr(apart - quantile) - ndtr(-apart - quantile), 1e-300))
    shift, growth, log = _gaussian(y, z, noise, unit)
    return shift, growth, log + _between_levels(slot, within)


def _one_level(slot: _Slot, y: Predicted, sigma: FloatArray) -> Level:
    """Confine y to the level; its edges are as soft as the extreme of n readings, moved in by its median."""
    params, step = slot.params, slot.step
    extreme = float(ndtri(2.0 ** (-1.0 / slot.n)))
    soft = sigma / math.sqrt(1.0 + 2.0 * math.log(slot.n))
    half = np.maximum(0.5 * step - extreme * sigma, 0.1 * step)
    total = np.sqrt(y.variance + soft**2)
    off = y.mean - slot.reading.last
    mean, variance, log_mass = truncated((-half - off) / total, (half - off) / total)
    sd = np.sqrt(y.variance)
    is_soft = sd < params.soft * soft
    is_news = (log_mass < math.log(params.news)) | (sd > params.wide * step)
    gain = y.variance / total
    return Level(is_soft | is_news, is_soft, gain * mean, gain**2 * (variance - 1.0), log_mass)


def _entered(slot: _Slot, level: Level) -> Part:
    # A slow error is renewed with its correlation time: to that share, a level that stays is new evidence.
    renewed = slot.params.renewal * slot.params.kinds.renewed
    log = np.where(level.enters, level.log_mass, renewed * level.log_mass)
    return level.enters * level.shift, level.enters * level.growth, log


def truncated(low: FloatArray, high: FloatArray) -> Part:
    """Return mean, variance and log mass of a standard normal between two bounds (Curry 1970).

    Written for the lower tail, so that it is stable far out on either side.
    """
    above = low > 0.0
    a, b = np.where(above, -high, low), np.where(above, -low, high)
    log_b = log_ndtr(b)
    log_mass = log_b + np.log1p(-np.exp(np.minimum(log_ndtr(a) - log_b, -1e-12)))
    at_a, at_b = (np.exp(-0.5 * bound**2 - log_mass) / ROOT_2_PI for bound in (a, b))
    mean = np.clip(at_a - at_b, a, b)
    variance = np.clip(1.0 + a * at_a - b * at_b - mean**2, 1e-6, 1.0)
    return np.where(above, -mean, mean), variance, log_mass
