"""The model of a temperature and its thermometer: states, models of the sensor noise, F and Q.

The state of each filter is x = (T, r, a, e): temperature, its rate, its acceleration, and the slow error of
the reading.  What a thermometer rounds to its steps is T + e + white noise.
"""

from __future__ import annotations

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
    """One hypothesis of the sensor noise.

    A *code model* reads the code in which T + e + white noise is; its unit of variance is d², of the step d.
    A *mean model* measures a slot's mean; its unit is ρ, the variance of this mean from slot to slot.
    """

    white: float
    """Variance of the white noise, units."""
    slow: float = 0.0
    """Variance of the slow error e, units."""
    slow_s: float = 1e9
    """Correlation time τ of e, s."""
    walk_per_s: float = 0.0
    """Variance per second of the random walk that is part of 1/f noise, units/s."""


def code_model(white_sd: float, slow_sd: float = 0.0, slow_s: float = 1e9, walk: float = 0.0) -> NoiseModel:
    """Return a code model by standard deviations in steps; e also moves within a slot, by σ √(1 s/(3 τ))."""
    slow = slow_sd**2
    return NoiseModel(white_sd**2 + slow * SLOT_S / (3.0 * slow_s), slow, slow_s, walk * slow)


def mean_model(slow: float = 0.0, slow_s: float = 1e9, walk_per_s: float = 0.0) -> NoiseModel:
    """Return a mean model, a share of whose ρ is the slow error."""
    return NoiseModel(1.0 - slow, slow, slow_s, walk_per_s)


CODE_MODELS = (
    *(
        code_model(white_sd)
        for white_sd in (0.02, 0.035, 0.05, 0.065, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5)
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
class Models:
    """The models of the sensor noise, k, and of the temperature, m; none is tuned to a sensor."""

    code_models: tuple[NoiseModel, ...] = CODE_MODELS
    mean_models: tuple[NoiseModel, ...] = MEAN_MODELS
    jerk_psds: tuple[float, ...] = JERK_PSDS
    change_per_s: float = 2e-3
    """Probability per second that the jerk PSD changes to a neighbour's."""

    @cached_property
    def noise(self) -> FloatArray:
        """The four fields of every `NoiseModel`, code models first, (4, k, 1)."""
        return np.array([*self.code_models, *self.mean_models], np.float64).T[:, :, np.newaxis]

    @property
    def code(self) -> slice:
        """Rows of the code models."""
        return slice(0, len(self.code_models))

    @property
    def mean(self) -> slice:
        """Rows of the mean models."""
        return slice(len(self.code_models), None)


@lru_cache(maxsize=64)
def dynamics(models: Models, dt: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return F, F ⊗ F, the decay of e, Q and the transitions of dt seconds: acceleration with white jerk.

    ::

        F = [[1, dt, dt²/2, 0], [0, 1, dt, 0], [0, 0, 1, 0], [0, 0, 0, φ]],  φ = exp(-dt/τ)
        Q = q [[dt⁵/20, dt⁴/8, dt³/6], [dt⁴/8, dt³/3, dt²/2], [dt³/6, dt²/2, dt]]

    F is (4, 4) and has 1 in place of φ, which depends on the noise model: the decay, (4, k, 1), is φ for e,
    and 1 for the other states.  F ⊗ F, (16, 16), is for vec(F P Fᵀ) = (F ⊗ F) vec P.  Q of T, r and a is
    (3, 3, 1, m), the transition matrix of the jerk PSDs (m, m).
    """
    f: FloatArray = np.eye(STATES)
    f[TEMPERATURE, RATE] = f[RATE, ACCELERATION] = dt
    f[TEMPERATURE, ACCELERATION] = 0.5 * dt**2
    decay = np.ones((STATES, len(models.noise[0]), 1))
    decay[ERROR] = np.exp(-dt / models.noise[2])
    q = np.array(
        [
            [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
            [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
            [dt**3 / 6.0, dt**2 / 2.0, dt],
        ]
    )
    transition = mode_transition(len(models.jerk_psds), min(dt * models.change_per_s, 0.4))
    f_kron_f = np.asarray(np.kron(f, f), np.float64)
    return f, f_kron_f, decay, q[:, :, np.newaxis, np.newaxis] * models.jerk_psds, transition
