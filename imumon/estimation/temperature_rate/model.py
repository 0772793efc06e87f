"""The model of a temperature and its thermometer: states, models of the sensor noise, F, Q and priors.

The state of each filter is x = (T, r, a, e): temperature, its rate, its acceleration, and the slow error of
the reading.  What a thermometer rounds to its steps is T + e + white noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.multiple_models import mode_transition

STATES = 4
TEMPERATURE, RATE, ACCELERATION, ERROR = range(STATES)
SLOT_S = 1.0
"""Samples are summarised over slots of this length, s."""


class NoiseModel(NamedTuple):
    """One hypothesis of the sensor noise, in units of `Thermometer.noise_scale` or of √ρ (mean models)."""

    white: float
    """Standard deviation of white noise; for a mean model its share of the variance ρ of a slot's mean."""
    slow_variance: float = 0.0
    """Variance of the slow error e, units²; for a mean model the share of ρ that e makes."""
    slow_s: float = 1e9
    """Correlation time of e, s."""
    walk_per_s: float = 0.0
    """Variance per second of the random walk that is part of 1/f noise, units²/s."""


def code_model(white: float, slow: float = 0.0, slow_s: float = 1e9, walk_per_s: float = 0.0) -> NoiseModel:
    """Return a model that reads the code which T + e is in; e also moves within a slot, by σ √(1 s/(3 τ))."""
    moves = slow * math.sqrt(SLOT_S / (3.0 * slow_s))
    return NoiseModel(math.hypot(white, moves), slow**2, slow_s, walk_per_s * slow**2)


def mean_model(slow: float = 0.0, slow_s: float = 1e9, walk_per_s: float = 0.0) -> NoiseModel:
    """Return a model that takes a slot's mean as a measurement with the variance ρ, between slots."""
    return NoiseModel(max(1.0 - slow, 0.05), slow, slow_s, walk_per_s)


CODE_MODELS = (
    *(
        code_model(white)
        for white in (0.02, 0.035, 0.05, 0.065, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5)
    ),
    code_model(0.1, 0.25, 5.0),
    code_model(0.1, 0.6, 5.0),
    code_model(0.1, 0.6, 40.0),
    code_model(0.1, 0.4, 3.0, 0.01),
)
"""White noise of 0.02 to 0.5 steps, a quarter apart where the ripple of a mean depends on it most, and slow
errors of seconds to a minute."""
MEAN_MODELS = (
    mean_model(),
    *(mean_model(share, slow_s) for share in (0.3, 1.0) for slow_s in (5.0, 40.0)),
    *(mean_model(share, 3.0, walk) for share, walk in ((0.3, 0.01), (1.0, 0.01), (1.0, 0.05))),
)
JERK_PSDS = tuple(10.0 ** (-23.0 + 2.5 * i) for i in range(9))
"""Power spectral densities q of white jerk, °C²/s⁵.  The rate gains √(q t³/3) in a time t: with the least,
0.17 °C/h in a day; with the largest, 1 °C/min in a second."""


@dataclass(frozen=True, eq=False)
class Params:
    """All that is assumed; what each is worth stands in docs/appendix/ablation-results.md.

    Nothing of it is tuned to a sensor.
    """

    code_models: tuple[NoiseModel, ...] = CODE_MODELS
    mean_models: tuple[NoiseModel, ...] = MEAN_MODELS
    jerk_psds: tuple[float, ...] = JERK_PSDS
    change_per_s: float = 2e-3
    """Probability per second that the jerk PSD changes to a neighbour's."""
    probability_floor: float = 1e-14
    """Least probability of a filter."""
    soft: float = 2.0
    """An edge is soft for a filter whose prediction has a sigma below so many of the edge's."""
    surprise: float = 0.02
    """A code is a surprise for a filter that gave it less than this probability."""
    wide: float = 1.5
    """A prediction is wide whose sigma exceeds so many steps."""
    spacing: float = 0.1
    """Relative standard deviation of the σ of a model: half the distance of two models."""
    renewal: float = 0.1
    """Share of the log likelihood of a code that stays, per renewal of the slow error."""
    edge_sd: float = 0.05
    """Standard deviation of the place of an edge, steps: linearity of a good converter."""
    hysteresis_sd: float = 0.5
    """The same until readings have gone back: the converter may have hysteresis."""
    slow_mean: float = 0.5
    """The mean of a slow error is known to so many of its sigmas."""
    memory_s: float = 80.0
    """A rate is not known better than the temperature's sigma over this time: a ramp may just have begun."""
    output_lag_s: float = 3.0
    """Time constant with which the rate in the output follows the estimate, so that it does not jump."""

    @cached_property
    def models(self) -> FloatArray:
        """The four fields of every `NoiseModel`, code models first, (4, k, 1)."""
        return np.array([*self.code_models, *self.mean_models], np.float64).T[:, :, np.newaxis]


class Dynamics(NamedTuple):
    """F, Q and mode transitions of a time step; e, whose φ depends on the noise model, is apart."""

    f: FloatArray
    """F of T, r and a, (4, 4); its element of e is 1."""
    f_kron_f: FloatArray
    """F ⊗ F, (16, 16): vec(F P Fᵀ) = (F ⊗ F) vec P."""
    decay: FloatArray
    """φ = exp(-dt/τ) of e, and 1 of the other states, (4, k, 1)."""
    q: FloatArray
    """Q of T, r and a, (3, 3, 1, m)."""
    transition: FloatArray
    """Transition matrix of the jerk PSDs, (m, m)."""


@lru_cache(maxsize=64)
def dynamics(params: Params, dt: float) -> Dynamics:
    """Return F, Q and transitions of a time step in s: constant acceleration driven by white jerk.

    ::

        F = [[1, dt, dt²/2, 0], [0, 1, dt, 0], [0, 0, 1, 0], [0, 0, 0, exp(-dt/τ)]]
        Q = q [[dt⁵/20, dt⁴/8, dt³/6], [dt⁴/8, dt³/3, dt²/2], [dt³/6, dt²/2, dt]]
    """
    f: FloatArray = np.eye(STATES)
    f[TEMPERATURE, RATE] = f[RATE, ACCELERATION] = dt
    f[TEMPERATURE, ACCELERATION] = 0.5 * dt**2
    slow_s = params.models[2]
    decay = np.ones((STATES, *slow_s.shape))
    decay[ERROR] = np.exp(-dt / slow_s)
    q = np.array(
        [
            [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
            [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
            [dt**3 / 6.0, dt**2 / 2.0, dt],
        ]
    )
    return Dynamics(
        f,
        np.asarray(np.kron(f, f), np.float64),
        decay,
        q[:, :, np.newaxis, np.newaxis] * params.jerk_psds,
        mode_transition(len(params.jerk_psds), min(dt * params.change_per_s, 0.4)),
    )
