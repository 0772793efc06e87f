"""The model of a temperature and its thermometer: states, kinds of sensor noise, F, Q and priors.

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
from imumon.filters.rates import FASTEST_RATE

STATES = 4
TEMPERATURE, RATE, ACCELERATION, ERROR = range(STATES)
SLOT_S = 1.0
"""Samples are summarised over slots of this length, s."""


class Kind(NamedTuple):
    """One hypothesis of the sensor noise.

    Units are steps of a level kind, and the standard deviation √ρ that slot means have of a mean kind.
    """

    white: float
    """Standard deviation of white noise, steps; for a mean kind its share of the variance ρ."""
    slow_variance: float = 0.0
    """Variance of the slow error e, units²; for a mean kind what ρ would show of it, over ρ."""
    slow_s: float = 1e9
    """Correlation time of e, s."""
    walk: float = 0.0
    """Variance per second of the random walk that is part of 1/f noise, units²/s."""


def level_kind(white: float, slow: float = 0.0, slow_s: float = 1e9, walk: float = 0.0) -> Kind:
    """Return a kind that reads the level which T + e is in; e also moves within a slot, by σ √(1 s/(3 τ))."""
    return Kind(math.hypot(white, slow * math.sqrt(SLOT_S / (3.0 * slow_s))), slow**2, slow_s, walk * slow**2)


def mean_kind(slow: float = 0.0, slow_s: float = 1e9, walk: float = 0.0) -> Kind:
    """Return a kind that takes a slot's mean as a measurement with the variance ρ, between slots."""
    return Kind(max(1.0 - slow, 0.05), slow, slow_s, walk)


LEVEL_KINDS = (
    *(
        level_kind(white)
        for white in (0.02, 0.035, 0.05, 0.065, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5)
    ),
    level_kind(0.1, 0.25, 5.0),
    level_kind(0.1, 0.6, 5.0),
    level_kind(0.1, 0.6, 40.0),
    level_kind(0.1, 0.4, 3.0, 0.01),
)
MEAN_KINDS = (
    mean_kind(),
    *(mean_kind(share, slow_s) for share in (0.3, 1.0) for slow_s in (5.0, 40.0)),
    *(mean_kind(share, 3.0, walk) for share, walk in ((0.3, 0.01), (1.0, 0.01), (1.0, 0.05))),
)
JERKS = tuple(10.0 ** (-23.0 + 2.5 * i) for i in range(9))
"""Densities of white jerk, °C²/s⁵: from 0.01 °C/h kept for a day to 2 °C/min at once."""


@dataclass(frozen=True, eq=False)
class Params:
    """All that is assumed; what each is worth stands in docs/appendix/ablation-results.md.

    Nothing of it is tuned to a sensor.
    """

    level_kinds: tuple[Kind, ...] = LEVEL_KINDS
    mean_kinds: tuple[Kind, ...] = MEAN_KINDS
    jerks: tuple[float, ...] = JERKS
    mix_s: float = 4.0
    """Filters are mixed so often: a fraction of the time in which one could take over."""
    neighbour_per_s: float = 1e-4
    """Probability per second that the smoothness changes to a neighbour's."""
    any_per_s: float = 1e-6
    """Probability per second that it changes to any other."""
    least: float = 1e-14
    """Least probability of a filter."""
    soft: float = 2.0
    """A level is soft for a filter whose prediction has a sigma below so many of the level's edge."""
    surprise: float = 0.02
    """A level is a surprise for a filter that gave it less than this probability."""
    wide: float = 1.5
    """A prediction is wide whose sigma exceeds so many steps."""
    spacing: float = 0.1
    """Relative standard deviation of the σ of a kind: half the distance of two hypotheses."""
    renewal: float = 0.1
    """Share of the log likelihood of a level that stays, per renewal of the slow error."""
    edge: float = 0.05
    """Standard deviation of the place of an edge, steps: linearity of a good converter."""
    sticky_edge: float = 0.5
    """The same until readings have gone back: the converter may have hysteresis."""
    slow_mean: float = 0.5
    """The mean of a slow error is known to so many of its sigmas."""
    onset_per_s: float = 1e-4
    """Rate at which ramps begin at once, 1/s: one in 3 h."""
    onset_rate: float = 0.1 * FASTEST_RATE
    """Rate of such a ramp, °C/s: 2 °C/min, the usual ramp of a chamber."""
    glide_s: float = 3.0
    """Time constant with which the rate shown follows the estimate, so that it does not jump."""

    @cached_property
    def kinds(self) -> Kinds:
        """The kinds of noise as arrays, level kinds first."""
        return Kinds.of(self)


@dataclass(frozen=True, eq=False)
class Kinds:
    """The kinds of noise as columns (k, 1) beside the smoothnesses (m,)."""

    levels: int
    """How many are level kinds; they come first."""
    white: FloatArray
    slow_variance: FloatArray
    slow_s: FloatArray
    walk: FloatArray
    renewed: FloatArray
    """1 - φ of a slot of the level kinds, (levels, 1)."""
    ripple: FloatArray
    """β = exp(-2π²σ²) of the level kinds, (levels, 1): in steps, E[reading] = x - β/π sin 2πx of white noise
    (Widrow and Kollar, Quantization Noise, 2008, ch. 4)."""

    @classmethod
    def of(cls, params: Params) -> Kinds:
        """Return the arrays of the kinds in a set of parameters."""
        rows = [*params.level_kinds, *params.mean_kinds]
        white, slow, slow_s, walk = np.array(rows, dtype=np.float64).T[:, :, np.newaxis]
        levels = len(params.level_kinds)
        # Second differences of slot means, ρ, show (1 - φ)(3 - φ)/3 of the variance of e.
        keep = np.exp(-SLOT_S / slow_s)
        shown = (1.0 - keep) * (3.0 - keep) / 3.0
        shown[:levels] = 1.0
        ripple = np.exp(-2.0 * np.pi**2 * white[:levels] ** 2)
        return cls(levels, white, slow / shown, slow_s, walk, 1.0 - keep[:levels], ripple)


class Dynamics(NamedTuple):
    """F and Q of a time step; e, whose φ depends on the kind of noise, is apart."""

    f: FloatArray
    """F of T, r and a, (4, 4); its element of e is 1."""
    f_kron_f: FloatArray
    """F ⊗ F, (16, 16): vec(F P Fᵀ) = (F ⊗ F) vec P."""
    decay: FloatArray
    """φ = exp(-dt/τ) of e, and 1 of the other states, (4, k, 1)."""
    q: FloatArray
    """Q of T, r and a, (3, 3, 1, m)."""


@lru_cache(maxsize=64)
def dynamics(params: Params, dt: float) -> Dynamics:
    """Return F and Q of a time step in s: constant acceleration driven by white jerk.

    ::

        F = [[1, dt, dt²/2, 0], [0, 1, dt, 0], [0, 0, 1, 0], [0, 0, 0, exp(-dt/τ)]]
        Q = q [[dt⁵/20, dt⁴/8, dt³/6], [dt⁴/8, dt³/3, dt²/2], [dt³/6, dt²/2, dt]]
    """
    f: FloatArray = np.eye(STATES)
    f[TEMPERATURE, RATE] = f[RATE, ACCELERATION] = dt
    f[TEMPERATURE, ACCELERATION] = 0.5 * dt**2
    decay = np.ones((STATES, len(params.kinds.slow_s), 1))
    decay[ERROR] = np.exp(-dt / params.kinds.slow_s)
    q = np.array(
        [
            [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
            [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
            [dt**3 / 6.0, dt**2 / 2.0, dt],
        ]
    )
    return Dynamics(
        f, np.asarray(np.kron(f, f), np.float64), decay, q[:, :, np.newaxis, np.newaxis] * params.jerks
    )


@lru_cache(maxsize=64)
def smoothness_transition(params: Params, dt: float) -> FloatArray:
    """Return the transition matrix of the smoothnesses over a time in s, (m, m)."""
    neighbour, other = (min(dt * rate, 0.4) for rate in (params.neighbour_per_s, params.any_per_s))
    return mode_transition(len(params.jerks), neighbour, other)
