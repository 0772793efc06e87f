"""A bank of Kalman filters, one for each mode, of unknown white noise σ² (West & Harrison, 1997, ch. 4).

The modes are fixed: static multiple models (Bar-Shalom et al., 2001, section 11.6.2).

Each filter has its mean x, its covariance P over σ², and of σ² an inverse-gamma posterior IG(a, β).  Gains do
not depend on σ², and S here is the innovation covariance over σ².  The predictive density of a measurement
is Student's t with 2 a degrees of freedom and squared scale S β/a, and it weighs the modes
of each axis: its noise and slope.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.modes import (
    SENSITIVITY,
    SENSITIVITY_SD,
    SLOPE,
    SLOPE_DEGC,
    STATES,
    WALK,
    Modes,
    measurement_row,
    propagated,
)
from imumon.estimation.gyro_bias.prediction import Prediction
from imumon.estimation.rest.slots import Measurement

MEMORY_S = 600.0
"""Over which σ² is averaged."""
PRIOR_COUNT, DECLARED_COUNT = 3.0, 0.5 * MEMORY_S
"""a of a σ² that second differences of 16 slots have shown, and of one that is declared."""
UNKNOWN = 1e8
"""Prior variance of w over σ²: turn-on biases of any gyro."""


@dataclass(frozen=True, eq=False)
class Bank:
    """The filters at a time, (3 axes, F modes, ...)."""

    modes: Modes
    mean: FloatArray
    covariance: FloatArray
    """P, over σ²."""
    log_weight: FloatArray
    """Logarithm of the likelihood of each mode, largest 0, (3, F)."""
    shape: float
    scale: FloatArray
    """a, and β in (rad/s)², (3, F)."""
    time_s: float
    degc: FloatArray
    """(3,)."""

    @classmethod
    def begin(cls, modes: Modes, white: FloatArray, count: float, first: Measurement) -> Bank:
        """Return filters that know nothing of the bias before the first measurement.

        `white` is σ², the variance of the mean rate of a second, (rad/s)², (3,), with `count` as its a.
        """
        variance = modes.process.copy()
        variance[..., WALK], variance[..., SLOPE] = UNKNOWN, modes.process[..., SLOPE] * SLOPE_DEGC
        variance[..., SENSITIVITY] = (SENSITIVITY_SD**2 / white)[:, np.newaxis, np.newaxis]
        scale = np.repeat(count * white[:, np.newaxis], modes.count, 1)
        start_s, zero = first.end_s - first.covered_s, np.zeros_like(variance)
        covariance = variance[..., np.newaxis] * np.eye(STATES)
        return cls(modes, zero, covariance, modes.log_prior, count, scale, start_s, first.degc)

    def fits(self, now: Measurement, sigmas: float) -> bool:
        """Return whether a mean is within so many sigmas of its prediction in each axis."""
        prediction = self.prediction.at(now.end_s, now.degc)
        bias, variance = prediction.bias(now.force)
        variance = variance + prediction.white / now.covered_s
        return bool(((now.rate - bias) ** 2 <= sigmas**2 * variance).all())

    def after(self, now: Measurement, jumped: bool = False) -> Bank:
        """Return the filters after a measurement; with `jumped` the bias may be any, and modes and σ²
        stay."""
        dt, warming = now.end_s - self.time_s, now.degc - self.degc
        mean, covariance = propagated(self.mean, self.covariance, self.modes.process, dt, warming)
        if jumped:
            covariance[..., WALK, WALK] += UNKNOWN
        h = measurement_row(now.force)
        cross = (covariance.reshape(-1, STATES) @ h).reshape(mean.shape)  # P Hᵀ
        spread = cross @ h + 1.0 / now.covered_s  # S
        innovation = now.rate[:, np.newaxis] - mean @ h
        gain = cross / spread[..., np.newaxis]
        mean += gain * innovation[..., np.newaxis]
        covariance -= gain[..., np.newaxis] * cross[..., np.newaxis, :]
        degc = np.where(np.isfinite(now.degc), now.degc, self.degc)
        bank = replace(self, mean=mean, covariance=covariance, time_s=now.end_s, degc=degc)
        return bank if jumped else bank._weighed(innovation**2 / spread, spread)

    def _weighed(self, square: FloatArray, spread: FloatArray) -> Bank:
        """Weigh the modes by their likelihoods, and learn σ², by squared innovations over S and S, (3, F)."""
        a, variance = self.shape, self.scale / self.shape
        likelihood = 0.5 * np.log(spread * variance) + (a + 0.5) * np.log1p(square / (2.0 * a * variance))
        weight = self.log_weight - likelihood
        weight = np.maximum(weight - weight.max(1, keepdims=True), np.log(1e-4))  # it may come back
        fade = min(1.0, 0.5 * MEMORY_S / (a + 0.5))
        scale = fade * (self.scale + 0.5 * square)
        return replace(self, log_weight=weight, shape=fade * (a + 0.5), scale=scale)

    @cached_property
    def prediction(self) -> Prediction:
        """Mean and covariance over all modes, in absolute units."""
        modes, w = self.modes, np.exp(self.log_weight)
        w = w / w.sum(1, keepdims=True)
        white = w * self.scale / max(self.shape - 1.0, 1.0)
        mean = (w[:, np.newaxis] @ self.mean)[:, 0]
        off = self.mean - mean[:, np.newaxis]
        flat = self.covariance.reshape(3, modes.count, -1)
        within = (white[:, np.newaxis] @ flat).reshape(3, STATES, STATES)
        covariance = within + (off * w[..., np.newaxis]).transpose(0, 2, 1) @ off
        process = (white[:, np.newaxis] @ modes.process)[:, 0]
        fast = (white * modes.fast).sum(1)
        return Prediction(mean, covariance, process, fast, white.sum(1), self.time_s, self.degc)

    def wider(self, variance: FloatArray) -> Bank:
        """Let the bias have changed by an unknown amount of this variance, (rad/s)², (3,)."""
        covariance = self.covariance.copy()
        covariance[..., WALK, WALK] += variance[:, np.newaxis] * self.shape / self.scale
        return replace(self, covariance=covariance)

    def with_noise_of(self, other: Bank) -> Bank:
        """Take σ² and the mode weights of another bank; the covariance of the states, P σ², stays."""
        ratio = self.scale / self.shape * other.shape / other.scale
        covariance = self.covariance * ratio[..., np.newaxis, np.newaxis]
        weight, shape, scale = other.log_weight, other.shape, other.scale
        return replace(self, covariance=covariance, log_weight=weight, shape=shape, scale=scale)

    def with_white(self, white: FloatArray) -> Bank:
        """Restart σ², the variance of the mean of a second, (rad/s)², (3,)."""
        scale = np.repeat(PRIOR_COUNT * white[:, np.newaxis], self.modes.count, 1)
        return self.with_noise_of(replace(self, shape=PRIOR_COUNT, scale=scale))
