"""A bank of Kalman filters, one for each mode, whose white noise is not known (West & Harrison, 1997, ch. 4).

Each filter has its mean x, its covariance P over σ², and of σ² an inverse-gamma posterior IG(a, β).  Gains do
not depend on σ², so nothing is filtered twice when σ² becomes known.  The predictive density of a measurement
is Student's t with 2 a degrees of freedom and squared scale S β/a, and it weighs the modes
of each axis: its noise and slope.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    propagate,
)
from imumon.estimation.gyro_bias.prediction import Prediction

MEMORY_S = 600.0
"""Over which σ² is averaged."""
LEAST_WEIGHT = float(np.log(1e-4))
PRIOR_COUNT, KNOWN_COUNT = 3.0, 1e6
"""a of a σ² that second differences of 16 slots have shown, and of one that is declared."""
UNKNOWN = 1e8
"""Prior variance of w over σ²: turn-on biases of any gyro."""
LARGEST_SURPRISE = 25.0
"""A squared innovation over its variance counts as no more for σ²: a knock is no noise."""


@dataclass(slots=True, eq=False)
class Bank:
    """The filters at a time, (3 axes, F modes, ...)."""

    modes: Modes
    mean: FloatArray
    covariance: FloatArray
    """Over σ²."""
    log_weight: FloatArray
    shape: float
    scale: FloatArray
    """a, and β, (3, F)."""
    known_noise: bool
    """Whether σ² is declared."""
    force: FloatArray
    """f0: specific force at the first rest, (3,)."""
    time_s: float
    degc: FloatArray
    """(3,)."""
    prediction: Prediction
    """Of the mixture, after the last update."""

    def copy(self) -> Bank:
        """Return a bank that goes its own way."""
        return replace(
            self, mean=self.mean.copy(), covariance=self.covariance.copy(),
            log_weight=self.log_weight.copy(), scale=self.scale.copy(),
        )  # fmt: skip


def start(
    modes: Modes, white: FloatArray, known_noise: bool, force: FloatArray, time_s: float, degc: FloatArray
) -> Bank:
    """Return filters that know nothing of the bias; `white`, (3,), is the variance of the mean of a
    second."""
    covariance = np.zeros((3, modes.count, STATES, STATES))
    diagonal = np.einsum("...ii->...i", covariance)
    diagonal[:] = modes.process
    diagonal[..., WALK], diagonal[..., SLOPE] = UNKNOWN, modes.process[..., SLOPE] * SLOPE_DEGC
    diagonal[..., SENSITIVITY] = (SENSITIVITY_SD**2 / white)[:, np.newaxis, np.newaxis]
    mean = np.zeros((3, modes.count, STATES))
    count = KNOWN_COUNT if known_noise else PRIOR_COUNT
    scale = np.repeat(count * white[:, np.newaxis], modes.count, 1)
    prediction = Prediction.of(np.zeros(3), np.full(3, UNKNOWN), 0.0, force, time_s)
    return Bank(
        modes,
        mean,
        covariance,
        np.zeros((3, modes.count)),
        count,
        scale,
        known_noise,
        force,
        time_s,
        degc,
        prediction,
    )


def rescale(bank: Bank, white: FloatArray) -> None:
    """Take another white noise, (3,), as of a fan that starts; what is known of the bias stays as it is."""
    scale = np.repeat(PRIOR_COUNT * white[:, np.newaxis], bank.modes.count, 1)
    bank.covariance *= (bank.scale / bank.shape * PRIOR_COUNT / scale)[..., np.newaxis, np.newaxis]
    bank.shape, bank.scale = PRIOR_COUNT, scale
    bank.prediction = prediction_of(bank)


def take_noise(bank: Bank, other: Bank) -> None:
    """Take what another bank has learned of the noise of the same gyros: σ², and the weights of the modes."""
    ratio = bank.scale / bank.shape * other.shape / other.scale
    bank.covariance *= ratio[..., np.newaxis, np.newaxis]
    bank.shape, bank.scale, bank.log_weight = other.shape, other.scale.copy(), other.log_weight.copy()


def predict(bank: Bank, time_s: float, degc: FloatArray) -> None:
    """Bring the filters to a time and temperatures, (3,); NaN is no change."""
    warming = degc - bank.degc
    propagate(bank.mean, bank.covariance, bank.modes.process, time_s - bank.time_s, warming)
    bank.time_s = time_s
    bank.degc = np.where(np.isfinite(degc), degc, bank.degc)


def update(bank: Bank, rate: FloatArray, force: FloatArray, seconds: float, weigh: bool = True) -> None:
    """Take the mean rate, (3,), of so many seconds at rest at a specific force.

    Parameters
    ----------
    weigh : bool
        Whether it weighs the modes and σ²: not where the bias has jumped.
    """
    h = measurement_row(force - bank.force)
    cross = (bank.covariance.reshape(-1, STATES) @ h).reshape(bank.mean.shape)  # P Hᵀ
    spread = cross @ h + 1.0 / seconds  # S
    innovation = rate[:, np.newaxis] - bank.mean @ h
    gain = cross / spread[..., np.newaxis]
    bank.mean += gain * innovation[..., np.newaxis]
    bank.covariance -= gain[..., np.newaxis] * cross[..., np.newaxis, :]
    if weigh:
        _weigh(bank, innovation**2 / spread, spread)
    bank.prediction = prediction_of(bank)


def _weigh(bank: Bank, square: FloatArray, spread: FloatArray) -> None:
    """Take the likelihood of innovations, whose squares over S are given, and learn σ² from them."""
    a, variance = bank.shape, bank.scale / bank.shape
    bank.log_weight -= 0.5 * np.log(spread * variance) + (a + 0.5) * np.log1p(square / (2.0 * a * variance))
    bank.log_weight -= bank.log_weight.max(1, keepdims=True)
    np.maximum(bank.log_weight, LEAST_WEIGHT, out=bank.log_weight)
    if not bank.known_noise:
        fade = min(1.0, 0.5 * MEMORY_S / (a + 0.5))
        bank.scale = fade * (bank.scale + 0.5 * np.minimum(square, LARGEST_SURPRISE * variance))
        bank.shape = fade * (a + 0.5)


def mode_probabilities(bank: Bank) -> FloatArray:
    """Return the probability of each mode, (3, F).

    The flicker level of the unit is the parent of its axes' levels: messages on a tree, so they are exact.
    """
    modes, w = bank.modes, np.exp(bank.log_weight)
    kinds = len(modes.levels)
    message = w.reshape(3, kinds, -1).sum(2) @ modes.levels
    others = (message.prod(0) / message) @ modes.levels.T
    w *= np.repeat(others, modes.count // kinds, axis=1)
    return np.asarray(w / w.sum(1, keepdims=True))


def prediction_of(bank: Bank) -> Prediction:
    """Return mean and covariance over all modes, in absolute units."""
    modes, w = bank.modes, mode_probabilities(bank)
    white = w * bank.scale / max(bank.shape - 1.0, 1.0)
    mean = (w[:, np.newaxis] @ bank.mean)[:, 0]
    off = bank.mean - mean[:, np.newaxis]
    within = (white[:, np.newaxis] @ bank.covariance.reshape(3, modes.count, -1)).reshape(3, STATES, STATES)
    covariance = within + (off * w[..., np.newaxis]).transpose(0, 2, 1) @ off
    process = (white[:, np.newaxis] @ modes.process)[:, 0]
    fast = (white * modes.fast).sum(1)
    return Prediction(mean, covariance, process, fast, white.sum(1), bank.force, bank.time_s, bank.degc)


def widen(bank: Bank, variance: FloatArray) -> None:
    """Let the bias have changed by an unknown amount of this variance, (rad/s)², (3,)."""
    bank.covariance[..., WALK, WALK] += variance[:, np.newaxis] * bank.shape / bank.scale
    bank.prediction = bank.prediction.wider(variance)


def forget(bank: Bank) -> None:
    """Let the bias be any."""
    bank.covariance[..., WALK, WALK] += UNKNOWN
