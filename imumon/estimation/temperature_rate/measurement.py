"""What the readings of a slot say of y = T + e, for all filters at once: one decision table.

d is the step, n the number of independent readings, p the share of readings above an edge.
s² = σ² + (r² + P_rr) (1 s)²/12 is the noise of a kind and the motion within the slot.  Rows are evaluated top
down; the last reading before the slot counts as one of its readings.

| the slot | filters | what enters the state |
|---|---|---|
| more than two levels | level kinds | z = mean less ripple, R = max(s², variance)/(n slope²) + (β d/π)²/8 |
| more than two levels, a single reading | level kinds | as one level |
| two levels | level kinds | z = edge + s Φ⁻¹(p), R = s² p(1-p)/(n φ²) + (0.1 s Φ⁻¹(p))² |
| one level: soft, a surprise, or prediction wide | level kinds | y is in the level: truncated Gaussian |
| one level | level kinds | nothing; the level only confines what is shown |
| any | mean kinds | z = mean, R = share of ρ + (d/n)²/12 |

"y is in the level" is one statement, however often it is read.  A level is *soft* for a filter whose
prediction is sharper than twice its noise: then each reading is independent evidence.  It is a *surprise* for
a filter that gave it less than 2 %.  A prediction is *wide* if it knows y to no better than 1.5 d.

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

ROOT_2_PI = math.sqrt(2.0 * math.pi)


class Predicted(NamedTuple):
    """The reading y = H x, H = [1, 0, 0, 1], as every filter predicts it, (k, m)."""

    mean: FloatArray
    variance: FloatArray
    gain: FloatArray
    """P Hᵀ / (H P Hᵀ), (4, k, m): how the state follows y."""

    def of(self, kinds: slice) -> Predicted:
        """Return the predictions of some kinds of noise."""
        return Predicted(self.mean[kinds], self.variance[kinds], self.gain[:, kinds])


def predicted_reading(x: FloatArray, p: FloatArray) -> Predicted:
    """Return the prediction of the reading before its white noise and steps."""
    cross = p[:, TEMPERATURE] + p[:, ERROR]
    variance = cross[TEMPERATURE] + cross[ERROR]
    return Predicted(x[TEMPERATURE] + x[ERROR], variance, cross / variance)


class Correction(NamedTuple):
    """Evidence of a slot on y for some filters, (k, m) each."""

    mean_change: FloatArray
    """Change of the mean of y, °C."""
    variance_change: FloatArray
    """Change of the variance of y, at most zero, °C²."""
    log_likelihood: FloatArray


class Level(NamedTuple):
    """Evidence of "y is in the level" for the level kinds."""

    enters: BoolArray
    """Filters whose state it corrects, (levels, m).  For the others it only confines what is shown."""
    truncation: Correction


class Evidence(NamedTuple):
    """Evidence of a slot for all filters."""

    correction: Correction
    level: Level | None
    """The level that all readings were on; None where there were several."""


def evaluate(
    params: Params, thermometer: Thermometer, reading: Reading, y: Predicted, square_rate: FloatArray
) -> Evidence:
    """Return the evidence of a slot with readings for every filter: the table above.

    Parameters
    ----------
    y : Predicted
        The reading as predicted for the middle of the slot.
    square_rate : array, (k, m)
        Mean square of the rate, r² + P_rr, (°C/s)².
    """
    levels = params.kinds.levels
    slot = _Slot(params, thermometer, reading, thermometer.independent(reading))
    of_levels, level = _levels(slot, y.of(slice(0, levels)), square_rate[:levels])
    of_means = _mean(slot, y.of(slice(levels, None)))
    return Evidence(Correction(*map(np.concatenate, zip(of_levels, of_means, strict=True))), level)


def _levels(slot: _Slot, y: Predicted, square_rate: FloatArray) -> tuple[Correction, Level | None]:
    """Evaluate the rows of the level kinds; return also the level if all readings were on one."""
    reading = slot.reading
    duration_s = max(SLOT_S, reading.gap_s)
    sigma = np.sqrt((slot.white * slot.step) ** 2 + square_rate * duration_s**2 / 12.0)
    span = (reading.highest - reading.lowest) / slot.step
    if span > 1.5 and reading.count > 1:
        return _many_levels(slot, y, sigma), None
    if 0.5 <= span <= 1.5:
        return _two_levels(slot, y, sigma), None
    level = _one_level(slot, y, sigma)
    return _entering(slot, level), level


@dataclass(frozen=True, slots=True)
class _Slot:
    """A slot with what all rows of the table need of it."""

    params: Params
    thermometer: Thermometer
    reading: Reading
    n: float
    """Independent readings, 1 at least."""

    @property
    def step(self) -> float:
        """The step d, °C."""
        return self.thermometer.step

    @property
    def white(self) -> FloatArray:
        """White noise σ/d of the level kinds, (levels, 1)."""
        return self.params.kinds.white[: self.params.kinds.levels]

    @property
    def cell(self) -> float:
        """Distance between the values that the mean can have, d/n, °C."""
        return max(self.step / self.n, 1e-6)


def _gaussian(
    y: Predicted, z: FloatArray | float, noise: FloatArray, unit: FloatArray | float, smear: float = 0.0
) -> Correction:
    """Correct by y = z with the variance R: v² / S; `unit` turns the density of z into a probability.

    `smear` is added to S in the likelihood alone: a cell as a Gaussian of the same height, so that no
    probability exceeds 1.
    """
    total = y.variance + noise
    innovation = z - y.mean
    mean_change, variance_change = y.variance * innovation / total, -(y.variance**2) / total
    total = total + smear
    log = np.log(unit / ROOT_2_PI) - 0.5 * np.log(total) - 0.5 * innovation**2 / total
    return Correction(mean_change, variance_change, log)


def _mean(slot: _Slot, y: Predicted) -> Correction:
    """Correct the mean kinds by the mean of the slot."""
    white = slot.params.kinds.white[slot.params.kinds.levels :]
    noise = white * slot.thermometer.mean_variance(slot.reading) + slot.cell**2 / 12.0
    return _gaussian(y, slot.reading.mean, noise, slot.cell, slot.cell**2 / (2.0 * math.pi))


def _many_levels(slot: _Slot, y: Predicted, sigma: FloatArray) -> Correction:
    ripple = slot.params.kinds.ripple
    offset = (slot.reading.mean - slot.reading.low) / slot.step
    place = np.full_like(ripple, offset)
    for _ in range(4):  # solve mean = x - β/π sin 2πx for x
        place = offset + np.minimum(ripple, 0.4) / math.pi * np.sin(2.0 * math.pi * place)
    # The mean follows x with this slope: 0.4 in the middle of a level for noise of a quarter of a step.
    slope = np.maximum(1.0 - 2.0 * ripple * np.cos(2.0 * math.pi * place), 0.2)
    noise = np.maximum(sigma**2, slot.reading.variance) / slot.n / slope**2
    noise += (ripple * slot.step / math.pi) ** 2 / 8.0
    mean_change, variance_change, log = _gaussian(
        y, slot.reading.low + slot.step * place, noise, slot.cell / slope
    )
    # Readings that scatter more than a kind's: the likelihood of their variance (χ² of n), zero in the mean.
    excess = np.maximum(slot.reading.variance / _rounded_variance(slot, place, sigma), 1.0)
    return Correction(
        mean_change, variance_change, log + 0.25 - 0.5 * slot.n * (excess - 1.0 - np.log(excess))
    )


def _rounded_variance(slot: _Slot, place: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the variance of readings of noise σ at a place x in steps: σ² + d²/12 and its first harmonic."""
    ripple = slot.params.kinds.ripple
    white = slot.white**2
    cosine, sine = ripple * np.cos(2.0 * math.pi * place), ripple * np.sin(2.0 * math.pi * place)
    harmonic = -cosine * (1.0 / math.pi**2 + 4.0 * white) - (sine / math.pi) ** 2
    return sigma**2 + slot.step**2 * np.maximum(1.0 / 12.0 + harmonic, 0.0)


def _two_levels(slot: _Slot, y: Predicted, sigma: FloatArray) -> Correction:
    reading = slot.reading
    count = reading.count + reading.jumped
    total = reading.count * reading.mean + (reading.before if reading.jumped else 0.0)
    share = min(
        max((total / count - reading.lowest) / (reading.highest - reading.lowest), 0.5 / count),
        1.0 - 0.5 / count,
    )
    edge = 0.5 * (reading.lowest + reading.highest)
    quantile = float(ndtri(share))
    density = math.exp(-0.5 * quantile**2) / ROOT_2_PI
    z = edge + sigma * quantile
    binomial = share * (1.0 - share) / (slot.n * density**2)
    noise = sigma**2 * (binomial + (slot.params.spacing * quantile) ** 2)
    unit = sigma / (density * slot.n)
    # All n readings are of these two levels: kinds of more noise would have read a third.
    apart = slot.step / sigma
    within = slot.n * np.log(np.maximum(ndtr(apart - quantile) - ndtr(-apart - quantile), 1e-300))
    mean_change, variance_change, log = _gaussian(y, z, noise, unit)
    return Correction(mean_change, variance_change, log + within)


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
    is_surprise = log_mass < math.log(params.surprise)
    is_wide = sd > params.wide * step
    gain = y.variance / total
    return Level(
        is_soft | is_surprise | is_wide, Correction(gain * mean, gain**2 * (variance - 1.0), log_mass)
    )


def _entering(slot: _Slot, level: Level) -> Correction:
    """Return what of a level enters the states and the mode probabilities."""
    mean_change, variance_change, log_mass = level.truncation
    # A slow error is renewed with its correlation time: to that share, a level that stays is new evidence.
    renewed = slot.params.renewal * slot.params.kinds.renewed
    log = np.where(level.enters, log_mass, renewed * log_mass)
    return Correction(level.enters * mean_change, level.enters * variance_change, log)


def truncated(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
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
