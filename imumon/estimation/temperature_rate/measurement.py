"""What the readings of a slot say to each filter of the bank: its states given them, and their probability.

A slot's readings are one of three kinds.

- *one level*: the temperature is inside it, away from the edges by what the noise demands.  Where a
  prediction is sharper than the noise, each such slot is a measurement.  Where it is not, the same interval
  says nothing new every second: it is applied to what is shown (`confined`), and taken into the state only
  when the prediction grows fast, has grown wider than the level, or contradicts it.
- *two levels*: the share of the upper one weighs the boundary between them.  Where a filter moves so fast
  that noise does not matter, the time of the crossing is the measurement.
- *more*: the mean is the measurement.

That is what the level kinds hear.  The mean and slow kinds take the mean of any slot with its errors.
Probabilities are those of the lattice that the mean of a slot's independent readings can take, whatever the
kind, so that all can be compared.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.bank import (
    KINDS,
    LEVEL,
    LEVEL_SIGMAS,
    MEAN,
    MEAN_FACTORS,
    RATE,
    SLOW,
    Bank,
    conditioned,
    reweighed,
)
from imumon.estimation.temperature_rate.moments import ROOT_2_PI, truncated, weigh
from imumon.estimation.temperature_rate.sensor import Reading, Sensor

SWEEP = 4.0
"""A crossing is timed where the temperature moves by so many noise deviations within a slot."""
CROWDED = 1.8
"""∫ φ²/(Φ(1 - Φ)): readings d °C apart that pass an edge locate it with a variance of d σ over this."""
SHARPER = 2.0
"""A prediction sharper than so many noise deviations sees the edge of a level as soft."""
WIDER = 1.5
"""A prediction wider than so many steps is replaced by the level."""
GROWN = 0.1
"""So is one that grows wider by so many steps from slot to slot: to stay is news then."""
SURPRISE = float(np.log(0.02))
"""So is one that has less than this log probability to be inside."""
EDGE = 1.5
"""Readings that do not flicker keep the temperature so many noise deviations from the edge."""
TINY = 1e-6

Moments = tuple[FloatArray, FloatArray, FloatArray]
"""Mean and variance of the reading without steps, and log probability of what was read; (q, k) each."""


def measured(bank: Bank, reading: Reading, sensor: Sensor) -> Bank:
    """Return the bank given the readings of a slot."""
    prior = bank.reading
    mean, variance, log_evidence = _as_mean(prior, reading, sensor)
    if sensor.step:
        level = _as_level(bank, prior, reading, sensor)
        for whole, part in zip((mean, variance, log_evidence), level, strict=True):
            whole[:, LEVEL] = part
    else:
        log_evidence[:, LEVEL] = -60.0
    after = conditioned(bank, mean, variance)
    after.weight = reweighed(bank.weight, log_evidence)
    return after


def _as_mean(prior: tuple[FloatArray, FloatArray], reading: Reading, sensor: Sensor) -> Moments:
    """Take the slot's mean as a measurement: the mean and slow kinds, (q, k)."""
    predicted, spread = prior
    cell = sensor.step / max(sensor.independent(reading), 1.0)
    # A reading that is repeated over m slots has a variance of m times what its slots show, and counts once.
    repeats = 1.0 / min(sensor.independent(reading), 1.0)
    own = np.zeros(KINDS)
    own[MEAN] = MEAN_FACTORS * sensor.roughness * repeats**2
    own[SLOW] = 0.5 * min(sensor.roughness, sensor.inside / max(sensor.independent(reading), 1.0))
    noise = own + cell**2 / 12.0 + TINY**2
    residual = sensor.linear(reading) - predicted
    # The cell as a Gaussian of the same height, so that no probability exceeds one.
    total = spread + noise
    smeared = total + (cell**2 if cell else TINY**2) / (2.0 * np.pi)
    log_cell = np.log(max(cell, TINY) / ROOT_2_PI)
    log_evidence = log_cell - 0.5 * np.log(smeared) - 0.5 * residual**2 / smeared
    return predicted + spread / total * residual, spread * noise / total, log_evidence


def _as_level(bank: Bank, prior: tuple[FloatArray, FloatArray], reading: Reading, sensor: Sensor) -> Moments:
    """Take the slot's readings as levels: the level kinds, (q, levels)."""
    mean, variance = (part[:, LEVEL] for part in prior)
    rate, rate_variance = bank.mean[:, LEVEL, RATE], bank.covariance[:, LEVEL, RATE, RATE]
    step, low, high = sensor.step, reading.low, reading.high
    noise = LEVEL_SIGMAS * step
    if np.isfinite(reading.before):
        low, high = min(low, reading.before), max(high, reading.before)
    if high - low > 1.5 * step:
        levels = (reading.high - reading.low) / step + 1.0
        inside = noise**2 / max(sensor.independent(reading), 1.0) + step**2 / 12.0 / levels**2
        total = variance + inside
        residual = reading.mean - mean
        log = (
            np.log(step / max(sensor.independent(reading), 1.0) / ROOT_2_PI)
            - 0.5 * np.log(total)
            - 0.5 * residual**2 / total
        )
        return mean + variance / total * residual, variance * inside / total, log
    sigma = np.hypot(noise, rate * reading.duration_s / np.sqrt(12.0))
    if high - low < 0.5 * step:
        edges = (reading.mean - 0.5 * step, reading.mean + 0.5 * step)
        grown = bank.growth[:, LEVEL] > (GROWN * step) ** 2
        return _stay((mean, variance, grown), edges, sensor.independent(reading), sigma, step)
    return _flicker_or_cross(mean, variance, rate, rate_variance, (low, high), reading, sensor, sigma)


def _stay(
    prior: tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]],
    edges: tuple[float, float],
    count: float,
    sigma: FloatArray,
    step: float,
) -> Moments:
    """Take a reading that does not change, where it says something new."""
    mean, variance, grown = prior
    low, high = edges
    sd = np.sqrt(variance)
    soft = sd < SHARPER * sigma
    deep = np.minimum(mean - low, high - mean) > 5.0 * sigma + 3.0 * sd
    shift, shrink, log_mass = truncated((low - mean) / sd, (high - mean) / sd)
    known = (sd < WIDER * step) & (log_mass > SURPRISE) & ~grown
    result_mean = np.where(known, mean, mean + shift * sd)
    result_variance = np.where(known, variance, shrink * variance)
    log_evidence = np.where(known, 0.0, log_mass)
    result_mean, result_variance = (
        np.where(soft, mean, result_mean),
        np.where(soft, variance, result_variance),
    )
    log_evidence = np.where(soft, 0.0, log_evidence)
    weighing = soft & ~deep
    if weighing.any():
        m, v, log = weigh((mean[weighing], sd[weighing]), edges, (count, count), sigma[weighing])
        result_mean[weighing], result_variance[weighing], log_evidence[weighing] = m, v, log
    return result_mean, result_variance, log_evidence


def _flicker_or_cross(
    mean: FloatArray,
    variance: FloatArray,
    rate: FloatArray,
    rate_variance: FloatArray,
    levels: tuple[float, float],
    reading: Reading,
    sensor: Sensor,
    sigma: FloatArray,
) -> Moments:
    """Take two neighbouring levels: the share of the upper one, or the time of the crossing."""
    edge = 0.5 * (levels[0] + levels[1])
    count, total = reading.count, reading.count * reading.mean
    crossed_between = np.isfinite(reading.before) and reading.before != reading.first
    if crossed_between:
        # The level changed between two slots: the last reading of the other belongs to the crossing.
        count, total = count + 1, total + reading.before
    share = float(
        np.clip((total / count - levels[0]) / (levels[1] - levels[0]), 0.5 / count, 1.0 - 0.5 / count)
    )
    # Independent readings change level this often; a single crossing changes it once.
    own = reading.changes / (2.0 * share * (1.0 - share))
    independent = max(sensor.independent(reading), 1.0)
    counted = float(np.clip(own, 1.0, independent))
    above, below = counted * share, counted * (1.0 - share)
    lattice = gammaln(counted + 1.0) - gammaln(above + 1.0) - gammaln(below + 1.0)
    lattice += np.log(counted / independent)
    result = weigh((mean, np.sqrt(variance)), (edge, edge), (above, below), sigma)
    log_evidence = result[2] + lattice
    noise = LEVEL_SIGMAS * sensor.step
    moved = np.abs(rate) * reading.duration_s
    few = 1.0 + SWEEP * noise * count / np.maximum(moved, TINY)
    upward = reading.last > edge
    sweeps = (moved > SWEEP * noise) & (reading.changes <= few) & ((rate > 0.0) == upward)
    if reading.changes % 2 == 0 or not sweeps.any():
        return result[0], result[1], log_evidence
    # A clean crossing comes after the readings at the level that is left.
    left = (1.0 - share if upward else share) * count
    begin = reading.start_s - (reading.gap_s if crossed_between else 0.0)
    since = reading.time_s - (begin + (left - 0.5) * reading.gap_s)
    each = np.maximum(np.abs(rate) * reading.gap_s, TINY**2)
    width = each * (each / 12.0 + noise / CROWDED) + rate_variance * since**2
    total_variance, residual = variance + width, edge + rate * since - mean
    crossing = (
        np.log(each * count / independent / ROOT_2_PI)
        - 0.5 * np.log(total_variance)
        - 0.5 * residual**2 / total_variance
    )
    return (
        np.where(sweeps, mean + variance / total_variance * residual, result[0]),
        np.where(sweeps, variance * width / total_variance, result[1]),
        np.where(sweeps, crossing, log_evidence),
    )


def confined(bank: Bank, reading: Reading, sensor: Sensor) -> Bank:
    """Return the bank with the level kinds confined to the level that is being read, for what is shown."""
    step, noise = sensor.step, LEVEL_SIGMAS * sensor.step
    mean, variance = bank.reading
    sd = np.sqrt(variance[:, LEVEL])
    half = 0.5 * step - np.minimum(EDGE * noise, 0.3 * step)
    offset = mean[:, LEVEL] - reading.last
    shift, shrink, log_mass = truncated((-half - offset) / sd, (half - offset) / sd)
    hard = sd >= SHARPER * noise
    mean, variance, weight = mean.copy(), variance.copy(), bank.weight.copy()
    mean[:, LEVEL] += np.where(hard, shift * sd, 0.0)
    variance[:, LEVEL] *= np.where(hard, shrink, 1.0)
    weight[:, LEVEL] *= np.where(hard, np.exp(log_mass), 1.0)
    total = weight.sum()
    if not total > 1e-200:
        # The level is out of reach of all filters.
        return bank
    shown = conditioned(bank, mean, variance)
    shown.weight = weight / total
    return shown
