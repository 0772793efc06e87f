"""What is shown: mean and variance of the mixture, what no model has of the variances, values at samples."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.estimation.temperature_rate.filter import LONG_S, RATE, TEMPERATURE, Filters, mixture, slow_error
from imumon.estimation.temperature_rate.thermometer import FASTEST_RATE, REVERSALS, SLOT_S, Thermometer

LINEARITY, HYSTERESIS = 0.05, 0.5
"""Standard deviation of the place of an edge, steps: of a good converter; of one that may have hysteresis, as
long as readings have not gone back.  Ablation."""
SLOW_MEAN = 0.5
"""The mean of a slow error is known to so many of its sigmas.  Ablation."""
RAMP_S = 80.0
"""A rate is not known better than the temperature's sigma over this time, s: a ramp may just have begun.
Ablation."""
LAG_S = 3.0
"""Time constant with which the rate in the output follows the estimate, s, so that it does not jump.
Ablation."""


class RateEstimate(NamedTuple):
    """Temperature and its rate with their standard deviations: °C, °C/s, °C and °C/s; NaN where unknown."""

    temperature: FloatArray
    rate: FloatArray
    temperature_sd: FloatArray
    rate_sd: FloatArray
    """One value per sample, (n,)."""


class RateMethod(Protocol):
    """A method that estimates the rate sample by sample, from readings up to that sample."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call."""


class Output(NamedTuple):
    """Estimate from a time on: a temperature of constant rate."""

    time_s: float = 0.0
    temperature: float = math.nan
    rate: float = math.nan
    """°C and °C/s."""
    temperature_sd: float = math.nan
    rate_sd: float = math.nan
    rate_offset: float = 0.0
    """Rate of the output until `time_s` less the new rate, °C/s; it decays with `LAG_S`."""
    late_s: float = math.inf
    """Age from which on readings are missing, s."""
    reading_sd: float = math.nan
    """Standard deviation of a single reading, °C."""


def output(thermometer: Thermometer, filters: Filters, before: Output, end_s: float) -> Output:
    """Return mean and standard deviation of the mixture from the end of a slot on."""
    mu, x, p = filters.mu, filters.x, filters.p
    temperature, variance = mixture(mu, x[TEMPERATURE], p[TEMPERATURE, TEMPERATURE])
    rate, rate_variance = mixture(mu, x[RATE], p[RATE, RATE])
    slow, walk = slow_error(thermometer)
    edge_sd = thermometer.step * (LINEARITY if thermometer.reversals >= REVERSALS else HYSTERESIS)
    variance += SLOW_MEAN**2 * float((mu * (slow + walk * LONG_S)).sum())
    variance += edge_sd**2 + (rate * thermometer.repeat_s) ** 2 / 3.0
    # A ramp that has just begun is hidden by the temperature's sigma and the step.
    rate_variance += (variance + thermometer.step**2 / 12.0) / RAMP_S**2
    offset = before.rate + math.exp(-(end_s - before.time_s) / LAG_S) * before.rate_offset - rate
    return Output(
        time_s=end_s,
        temperature=temperature + (end_s - filters.time_s) * rate,
        rate=rate,
        temperature_sd=math.sqrt(variance),
        rate_sd=math.sqrt(rate_variance),
        rate_offset=0.0 if math.isnan(offset) else offset,
        late_s=SLOT_S + thermometer.neighbour_s,
        reading_sd=thermometer.reading_sd,
    )


def extrapolate(age: FloatArray, known: BoolArray, reading: FloatArray, shown: Output) -> RateEstimate:
    """Return the estimates at samples from the output of the last slot; all arrays are (n,).

    Before the first slot of a segment ends, and behind a gap until the next slot ends, there is the reading,
    with its standard deviation (NaN while it is unknown), and any rate.
    """
    late = known & (age > shown.late_s) & np.isfinite(shown.rate)
    known = known & ~late
    fading = np.exp(-age / LAG_S, where=known, out=np.zeros_like(age)) * shown.rate_offset
    # A slot is known when the next begins; readings farther apart leave the temperature to the rate.
    waited = np.maximum(age - 2.0 * SLOT_S, 0.0)
    unknown = 0.0 * reading
    return RateEstimate(
        temperature=np.where(known, shown.temperature + age * shown.rate, reading),
        rate=np.where(known, shown.rate + fading, unknown + np.where(late, shown.rate, 0.0)),
        temperature_sd=np.where(
            known, np.hypot(shown.temperature_sd, waited * shown.rate_sd), unknown + shown.reading_sd
        ),
        rate_sd=np.where(known, np.hypot(shown.rate_sd, fading), unknown + FASTEST_RATE),
    )
