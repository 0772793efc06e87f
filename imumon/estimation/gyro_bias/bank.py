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
from imumon.estimation.rest.slots import Second

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

    def predict(self, time_s: float, degc: FloatArray) -> None:
        """Bring the filters to a time and temperatures, (3,); NaN is no change."""
        propagate(self.mean, self.covariance, self.modes.process, time_s - self.time_s, degc - self.degc)
        self.time_s, self.degc = time_s, np.where(np.isfinite(degc), degc, self.degc)

    def update(self, now: Second, weigh: bool = True) -> None:
        """Take a second at rest; `weigh`: as evidence of the modes and of σ², too."""
        if np.isnan(self.force[0]):
            self.force = now.force  # accelerometers that come late
        h = measurement_row(now.force - self.force)
        cross = (self.covariance.reshape(-1, STATES) @ h).reshape(self.mean.shape)  # P Hᵀ
        spread = cross @ h + 1.0 / now.seconds  # S
        innovation = now.rate[:, np.newaxis] - self.mean @ h
        gain = cross / spread[..., np.newaxis]
        self.mean += gain * innovation[..., np.newaxis]
        self.covariance -= gain[..., np.newaxis] * cross[..., np.newaxis, :]
        if weigh:
            self._weigh(innovation**2 / spread, spread)
        self.prediction = self._mixture()

    def _weigh(self, square: FloatArray, spread: FloatArray) -> None:
        """Take the likelihood of innovations, whose squares over S are given, and learn σ² from them."""
        a, variance = self.shape, self.scale / self.shape
        likelihood = 0.5 * np.log(spread * variance) + (a + 0.5) * np.log1p(square / (2.0 * a * variance))
        self.log_weight -= likelihood
        self.log_weight -= self.log_weight.max(1, keepdims=True)
        np.maximum(self.log_weight, LEAST_WEIGHT, out=self.log_weight)
        if not self.known_noise:
            fade = min(1.0, 0.5 * MEMORY_S / (a + 0.5))
            self.scale = fade * (self.scale + 0.5 * np.minimum(square, LARGEST_SURPRISE * variance))
            self.shape = fade * (a + 0.5)

    @property
    def mode_probabilities(self) -> FloatArray:
        """The probability of each mode, (3, F).

        The flicker level of the unit is the parent of its axes' levels: exact messages on a tree.
        """
        levels, w = self.modes.levels, np.exp(self.log_weight)
        message = w.reshape(3, len(levels), -1).sum(2) @ levels
        others = (message.prod(0) / message) @ levels.T
        w *= np.repeat(others, self.modes.count // len(levels), axis=1)
        return np.asarray(w / w.sum(1, keepdims=True))

    def _mixture(self) -> Prediction:
        """Return mean and covariance over all modes, in absolute units."""
        modes, w = self.modes, self.mode_probabilities
        white = w * self.scale / max(self.shape - 1.0, 1.0)
        mean = (w[:, np.newaxis] @ self.mean)[:, 0]
        off = self.mean - mean[:, np.newaxis]
        flat = self.covariance.reshape(3, modes.count, -1)
        within = (white[:, np.newaxis] @ flat).reshape(3, STATES, STATES)
        covariance = within + (off * w[..., np.newaxis]).transpose(0, 2, 1) @ off
        process = (white[:, np.newaxis] @ modes.process)[:, 0]
        fast = (white * modes.fast).sum(1)
        return Prediction(mean, covariance, process, fast, white.sum(1), self.force, self.time_s, self.degc)

    def widen(self, variance: FloatArray) -> None:
        """Let the bias have changed by an unknown amount of this variance, (rad/s)², (3,)."""
        self.covariance[..., WALK, WALK] += variance[:, np.newaxis] * self.shape / self.scale
        self.prediction = self.prediction.wider(variance)

    def forget(self) -> None:
        """Let the bias be any."""
        self.covariance[..., WALK, WALK] += UNKNOWN

    def set_noise(self, shape: float, scale: FloatArray) -> None:
        """Set the posterior of σ², a and β (3, F); what is known of the bias stays as it is."""
        self.covariance *= (self.scale / self.shape * shape / scale)[..., np.newaxis, np.newaxis]
        self.shape, self.scale = shape, scale

    def restart_noise(self, white: FloatArray) -> None:
        """Take another white noise of a second, (3,), where it is not declared: as of a fan that starts."""
        if not self.known_noise:
            self.set_noise(PRIOR_COUNT, np.repeat(PRIOR_COUNT * white[:, np.newaxis], self.modes.count, 1))
            self.prediction = self._mixture()


def start(modes: Modes, white: FloatArray, known_noise: bool, first: Second) -> Bank:
    """Return filters that know nothing of the bias before a second at rest.

    Parameters
    ----------
    white : array (3,)
        Variance of the mean rate of a second, (rad/s)²; declared where `known_noise`.
    """
    covariance = np.zeros((3, modes.count, STATES, STATES))
    diagonal = np.einsum("...ii->...i", covariance)
    diagonal[:] = modes.process
    diagonal[..., WALK], diagonal[..., SLOPE] = UNKNOWN, modes.process[..., SLOPE] * SLOPE_DEGC
    diagonal[..., SENSITIVITY] = (SENSITIVITY_SD**2 / white)[:, np.newaxis, np.newaxis]
    count, time_s = KNOWN_COUNT if known_noise else PRIOR_COUNT, first.end_s - first.seconds
    return Bank(
        modes,
        mean=np.zeros((3, modes.count, STATES)),
        covariance=covariance,
        log_weight=np.zeros((3, modes.count)),
        shape=count,
        scale=np.repeat(count * white[:, np.newaxis], modes.count, 1),
        known_noise=known_noise,
        force=first.force,
        time_s=time_s,
        degc=first.degc,
        prediction=Prediction.of(np.zeros(3), np.full(3, UNKNOWN), 0.0, first.force, time_s),
    )
