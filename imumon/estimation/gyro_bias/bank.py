"""Kalman filters of a gyro's bias, one for each mode: a hypothesis of its noise and of its slope.

The model
---------
Per axis the state is::

    x = [w, g1, g2, g3, s, m1, m2, m3]

    w   walk, rad/s                 w' = w + s dT + N(0, K² dt)
    gi  flicker, rad/s              gi' = e^(-dt/τi) gi + N(0, σg² (1 - e^(-2 dt/τi))),  τ = 1, 30, 1000 s
    s   slope, rad/s per °C         s' = s + N(0, q |dT|),  q = σs² / 30 °C
    m   sensitivity to the specific force, rad/s per m/s², constant

    bias = w + g1 + g2 + g3 + m f = H x    (K in rad/s/√s, σg and σs as gi and s, dt s, dT °C, f m/s²)

Within a step w follows the walk of s: so Q also has q |dT|³/3 of w, and q dT |dT|/2 between w and s.
Three Gauss-Markov processes of one variance, a decade and a half apart, are flicker noise of coefficient B,
rad/s: σg² = B² ln(τ3/τ2) / π: flicker has a variance of B² ln(ratio) / π in each interval of time constants.

Modes
-----
Five of the noise (four flickers without walk, and a walk without flicker; one if declared) times those of the
slope: static multiple models (Bar-Shalom, 2001, 11.6).
White noise σ², (rad/s)² (of the mean of a second), is not known (West & Harrison, 1997, ch. 4): each filter
has its mean x, its covariance P over σ², and of σ² an inverse-gamma posterior IG(a, β).  Gains do not depend
on σ², and S here is the innovation covariance over σ².  The predictive density of a measurement is Student's
t with 2 a degrees of freedom and squared scale S β/a, and it weighs the modes of each axis; all variances
that are used are means, with E[σ²] = β/(a - 1).

All modes have one F, so the moments of their mixture, the *prediction*, propagate as those of each of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.estimation.rest.slots import Measurement
from imumon.geodesy import STANDARD_GRAVITY

STATES = 8
IDENTITY = np.eye(STATES)
WALK, G1, FLICKER, SLOPE, SENSITIVITY = 0, 1, slice(1, 4), 4, slice(5, 8)
TAUS_S = np.array([1.0, 30.0, 1000.0])  # of the flicker: from a second to the longest rest that matters
FLOOR_OF_FLICKER = 0.664  # floor of the Allan deviation over B, sqrt(2 ln 2 / π) (IEEE 952)
FLICKER_CORNERS_S = (100.0, 10.0, 1.0, 0.1)  # averaging times at which flicker overtakes white noise
STRONG_FLICKER = 2.0  # prior of corner 1 s over others: with 1, before it shows, B of 40 °/h was 8 sigmas off
WALK_CORNER_S = 10.0  # averaging time at which a random walk overtakes white noise: both are equal at √3 σ/K
SLOPE_PER_SIGMA = 3.6  # sd of the slope over σ, 1/°C: 60 °/h/°C for a gyro of 0.28 °/√h.  Assumed.
SLOPE_LEFT_PER_SIGMA = 0.25  # the same, 1/°C, of the slope that a model's curve leaves.  Assumed.
SLOPE_DEGC = 30.0  # difference of temperature over which a slope changes by as much as itself
SENSITIVITY_SD = math.radians(0.06) / STANDARD_GRAVITY  # of m, rad/s per m/s², uncompensated.  Assumed.
# Variance of the flicker of samples that is faster than g1, from 0.02 s on, over that of g1.  Assumed.
FASTER = math.log(TAUS_S[0] / 0.02) / math.log(TAUS_S[2] / TAUS_S[1])
END_LESS_MEAN = 0.47  # Var(g1 after its τ, a second, less its mean over it) / Var(g1): 1 + 2/e - 2 (1 - 1/e)
LEAST_WHITE = 1e-15  # (rad/s)², of the mean of a second: 0.0065 °/h, less than any gyro has.  Assumed.
MEMORY_S = 600.0  # time over which σ² is averaged, in measurements of about a second
PRIOR_SHAPE, DECLARED_SHAPE = 3.0, 0.5 * MEMORY_S  # shape a of a σ² by a trial of 16 slots; of a declared one
LEAST_WEIGHT = 1e-4  # least weight of a mode over the largest, so that the mode may come back
UNKNOWN = 1e8  # variance over σ² of a w that may be any; its sd is `TURN_ON` at least.  Assumed.
TURN_ON = math.radians(3.0)  # rad/s, sd of a bias that differs from one start to the next.  Assumed.


@dataclass(frozen=True, eq=False)
class States:
    """States of three axes, (3, ..., 8): those of all modes over σ², or of their mixture."""

    noise_scale: FloatArray  # K² of w, per s, σg² of each gi, q of s, per °C, and 0 of m, (3, ..., 8)
    mean: FloatArray  # x, (3, ..., 8)
    covariance: FloatArray  # P, (3, ..., 8, 8)
    time_s: float
    held_degc: FloatArray  # temperature of each gyro, with a dead band of its sd, (3,)
    degc_and_sd: FloatArray  # temperature at the last measurement, and its sd, °C, (2, 3)

    def at(self, time_s: float, degc_and_sd: FloatArray) -> Self:
        """Return F x and F P Fᵀ + Q at a later time, and temperature and sd, °C, (2, 3); NaN: no change."""
        dt, (degc, degc_sd) = time_s - self.time_s, degc_and_sd
        if dt <= 0.0:
            return self
        held = np.where(np.isnan(self.held_degc), degc, self.held_degc)
        # What is within a sigma has not moved: else noise, which moves no bias, draws the slope to zero.
        held = np.fmin(np.fmax(held, degc - degc_sd), degc + degc_sd)
        axes = (3,) + (1,) * (self.mean.ndim - 2)  # alike in all modes
        warming = _where_known(held - self.held_degc).reshape(axes)  # dT
        keeps = np.exp(-dt / TAUS_S)
        f, growth = np.zeros((*axes, STATES, STATES)), np.zeros((*axes, STATES))
        f[:] = IDENTITY
        f[..., FLICKER, FLICKER] *= keeps
        f[..., WALK, SLOPE] = warming
        growth[..., WALK], growth[..., FLICKER], growth[..., SLOPE] = dt, 1.0 - keeps**2, np.abs(warming)
        covariance = f @ self.covariance @ f.swapaxes(-1, -2)
        # Diagonal of Q, added through a view: K² dt, σg² (1 - e^(-2 dt/τ)), q |dT|.
        np.einsum("...ii->...i", covariance)[...] += self.noise_scale * growth
        # Of w by the walk of s within the step: q |dT|³/3, and q dT |dT|/2 between both.
        walk = self.noise_scale[..., SLOPE] * np.abs(warming)
        covariance[..., WALK, WALK] += walk * warming**2 / 3.0
        cross = walk * warming / 2.0
        covariance[..., WALK, SLOPE] += cross
        covariance[..., SLOPE, WALK] += cross
        mean = (f @ self.mean[..., None])[..., 0]
        return replace(self, mean=mean, covariance=covariance, time_s=time_s, held_degc=held)


def _where_known(change: FloatArray) -> FloatArray:
    """Return a change, zero where it is NaN; `nan_to_num` takes several times as long."""
    return np.where(np.isnan(change), 0.0, change)


def measurement_row(force: FloatArray) -> FloatArray:
    """Return H, (8,), at a specific force, m/s², (3,); zero where it is not known."""
    return np.array([1.0, 1.0, 1.0, 1.0, 0.0, *force])


TO_TERMS = np.vstack([measurement_row(np.zeros(3)), IDENTITY[SENSITIVITY]])  # `LinearBias.terms` of x


class LinearBias(NamedTuple):
    """A bias as a linear function of the specific force f, t (1, f); NaN where nothing is known."""

    terms: FloatArray  # t: bias without specific force, rad/s, and sensitivity, rad/s per m/s², (3, 4)
    covariance: FloatArray  # C of t, (3, 4, 4)
    force: FloatArray  # mean f of the slot, m/s², (3,)
    turn_hypothesis: FloatArray  # rad/s, (3,); its square is not in C


@dataclass(frozen=True, eq=False)
class Prediction(States):
    """The mixture of all modes, with Q and P in absolute units, not over σ²."""

    white: FloatArray  # variance of the white noise of a second, (rad/s)², (3,)

    @property
    def slope_square(self) -> FloatArray:
        """E[s²], (rad/s/°C)², (3,)."""
        return self.mean[:, SLOPE] ** 2 + self.covariance[:, SLOPE, SLOPE]

    def ahead_to(self, time_s: float, degc_and_sd: FloatArray) -> Self:
        """As `at`, and w follows dT within the dead band, too; not of its own result, which has that."""
        (degc, sd), (degc_before, sd_before) = degc_and_sd, self.degc_and_sd
        then = self.at(time_s, degc_and_sd)
        left = _where_known(degc - degc_before - (then.held_degc - self.held_degc))
        hidden = np.fmax(sd**2 - sd_before**2, 0.0)  # by a silent thermometer; NaN: 0
        mean, covariance = then.mean.copy(), then.covariance.copy()
        mean[:, WALK] += mean[:, SLOPE] * left
        # dT within the band may be noise of the thermometer: all that it does, s dT, is in the variance, too.
        covariance[:, WALK, WALK] += self.slope_square * (left**2 + hidden)
        return replace(then, mean=mean, covariance=covariance)

    def bias(self, force: FloatArray, of_mean: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return bias and variance at a specific force, (3,) each; `of_mean`: the variance without g1."""
        h = measurement_row(force)
        mean = self.mean @ h
        if of_mean:
            h[G1] = 0.0
        return mean, np.maximum(self.covariance @ h @ h, 0.0)

    def innovation(self, now: Measurement) -> tuple[FloatArray, FloatArray]:
        """Return a mean rate less its prediction, rad/s, and the variance of that, (3,) each."""
        bias, variance = self.ahead_to(now.end_s, now.degc_and_sd).bias(now.force)
        return now.rate - bias, variance + self.white / now.covered_s + now.rounding_sd**2

    def output(self, added: FloatArray, force: FloatArray, turn: FloatArray) -> LinearBias:
        """Return the bias with `added` variance, (rad/s)², at the mean force of a slot, m/s², (3,) each."""
        covariance = TO_TERMS @ self.covariance @ TO_TERMS.T
        covariance[:, 0, 0] += FASTER * self.noise_scale[:, G1] + added
        return LinearBias(self.mean @ TO_TERMS.T, covariance, force, turn)


def at_samples(
    rows: IntArray, biases: list[LinearBias], force: FloatArray, moving: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return bias t (1, f), variance (1, f) C (1, f) and turn hypothesis of samples, (n, 3) each.

    Each of `biases` but the first holds from its row on.  f is the specific force of the sample, (n, 3); at
    rest, where its noise is no change of pose, and without accelerometers, that of the slot.
    """
    which = np.searchsorted(rows, np.arange(len(moving)), side="right")
    terms, covariance, of_slot, turn = (np.array(one) for one in zip(*biases, strict=True))
    bias, variance = (one[which] for one in _at_force(terms, covariance, of_slot))
    moves = moving & np.isfinite(force).all(1)
    of_sample = which[moves]
    bias[moves], variance[moves] = _at_force(terms[of_sample], covariance[of_sample], force[moves])
    return bias, variance, turn[which]


def _at_force(terms: FloatArray, covariance: FloatArray, force: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return t (1, f) and (1, f) C (1, f), (n, 3) each, of n biases at n specific forces, (n, 3)."""
    h = np.ones((len(force), 1, 4))
    h[:, 0, 1:] = force
    # No matrix products: their order of sums may depend on n, so the bits on the division into blocks.
    variance = ((covariance * h[:, None]).sum(3) * h).sum(2)
    return (terms * h).sum(2), np.maximum(variance, 0.0)


@dataclass(frozen=True, eq=False)
class Bank(States):
    """The filters at a time, (3 axes, F modes, ...), Q and P over σ²."""

    log_weight: FloatArray  # ln of the weight of each mode, but for a constant, (3, F)
    shape: float  # a, of all axes, which are measured at once
    scale: FloatArray  # β, (rad/s)², (3, F)
    declared: bool  # whether B and K are, so that Q σ² stays where σ² changes, as by a fan

    @classmethod
    def begin(
        cls, noise: Sequence[FloatArray | None], slopes: Sequence[float], white: FloatArray, now: Measurement
    ) -> "Bank":
        """Return filters after the first measurement, before which nothing is known of the bias.

        `noise` are declared σ, rad/√s, B, rad/s, and K, rad/s/√s, (3,) each, or None; `slopes` standard
        deviations of the slope over σ, 1/°C; `white` is σ² as measured, (rad/s)², (3,).
        """
        sigma, b, k = noise
        count = PRIOR_SHAPE
        if sigma is not None:
            white, count = np.maximum(sigma**2, LEAST_WHITE), DECLARED_SHAPE
        # `white` is β/a; after a trial E[σ²] is 1.5 times that, as few degrees of freedom leave it uncertain.
        expected = count / (count - 1.0) * white
        noise_scale, log_prior = _modes(b, k, slopes, expected)
        variance = noise_scale.copy()
        variance[..., WALK] = 0.0  # it is set by `after`
        variance[..., SLOPE] *= SLOPE_DEGC
        variance[..., SENSITIVITY] = (SENSITIVITY_SD**2 / expected)[:, None, None]
        before = cls(
            noise_scale=noise_scale,
            mean=np.zeros_like(variance),
            covariance=variance[..., None] * IDENTITY,
            time_s=now.end_s - now.covered_s,
            held_degc=now.degc_and_sd[0],
            degc_and_sd=now.degc_and_sd,
            log_weight=log_prior,
            shape=count,
            scale=np.tile(count * white[:, None], noise_scale.shape[1]),
            declared=b is not None,
        )
        return before.after(now, jumped=True)

    def fits(self, now: Measurement, sigmas: float) -> bool:
        """Return whether a mean is within so many sigmas of its prediction in each axis."""
        innovation, variance = self.prediction.innovation(now)
        return bool((innovation**2 <= sigmas**2 * variance).all())

    def after(self, now: Measurement, jumped: bool = False) -> "Bank":
        """Return the filters after a measurement.

        With `jumped` the bias may be any, so the mean rate shows nothing of modes and σ², which stay.
        """
        prior = self.at(now.end_s, now.degc_and_sd)
        if jumped:
            prior = prior.wider(np.maximum(UNKNOWN * self.white, TURN_ON**2))
        h = measurement_row(now.force)
        cross = (prior.covariance.reshape(-1, STATES) @ h).reshape(prior.mean.shape)  # P Hᵀ
        # S = H P Hᵀ + R, over σ².  Rounding is not in R: it is the same in each mean (`rounding_error`).
        spread = cross @ h + 1.0 / now.covered_s
        innovation = now.rate[:, None] - prior.mean @ h
        gain = cross / spread[..., None]
        mean = prior.mean + gain * innovation[..., None]
        covariance = prior.covariance - gain[..., None] * cross[..., None, :]
        degc_and_sd = np.where(np.isfinite(now.degc_and_sd[0]), now.degc_and_sd, prior.degc_and_sd)
        bank = replace(prior, mean=mean, covariance=covariance, degc_and_sd=degc_and_sd)
        if jumped:
            return bank
        a, square = self.shape, innovation**2 / spread
        # Student's t, but for a constant: 2 a degrees of freedom, squared scale S β/a.
        minus_log = 0.5 * np.log(spread * self.scale) + (a + 0.5) * np.log1p(0.5 * square / self.scale)
        weight = self.log_weight - minus_log
        weight = np.maximum(weight - weight.max(1, keepdims=True), np.log(LEAST_WEIGHT))
        shape = min(a + 0.5, 0.5 * MEMORY_S)  # older measurements count less and less
        scale = shape / (a + 0.5) * (self.scale + 0.5 * square)
        return bank._with_noise(weight, shape, np.maximum(scale, (shape - 1.0) * LEAST_WHITE))

    def _with_noise(self, log_weight: FloatArray, shape: float, scale: FloatArray) -> "Bank":
        bank = replace(self, log_weight=log_weight, shape=shape, scale=scale)
        if not self.declared:
            return bank
        return replace(bank, noise_scale=self.noise_scale * (self.white / bank.white)[..., None])

    @property
    def white(self) -> FloatArray:
        """E[σ²], the mean of the inverse-gamma posterior, (rad/s)², (3, F)."""
        return self.scale / (self.shape - 1.0)

    @cached_property
    def prediction(self) -> Prediction:
        """Mean and covariance over all modes, in absolute units."""
        w = np.exp(self.log_weight)
        w = w / w.sum(1, keepdims=True)
        weighted = w * self.white
        mean = (w[:, None] @ self.mean)[:, 0]
        off = self.mean - mean[:, None]
        flat = self.covariance.reshape(*w.shape, -1)
        within = (weighted[:, None] @ flat).reshape(3, STATES, STATES)
        covariance = within + (off * w[..., None]).transpose(0, 2, 1) @ off
        noise_scale = (weighted[:, None] @ self.noise_scale)[:, 0]
        # g1 at the end of a second is not its mean over it, by which it was updated; that dies away with g1.
        covariance[:, G1, G1] += END_LESS_MEAN * noise_scale[:, G1]
        white = weighted.sum(1)
        return Prediction(noise_scale, mean, covariance, self.time_s, self.held_degc, self.degc_and_sd, white)

    def wider(self, variance: FloatArray) -> "Bank":
        """Let the bias have changed by an unknown amount of this variance, (rad/s)², (3,) or (3, F)."""
        covariance = self.covariance.copy()
        covariance[..., WALK, WALK] += variance.reshape(3, -1) / self.white
        return replace(self, covariance=covariance)

    def with_learned_noise(self, other: "Bank") -> "Bank":
        """Take σ² and mode weights of another bank of these gyros; the covariance of states, P σ², stays."""
        ratio = self.white / other.white
        bank = replace(self, covariance=self.covariance * ratio[..., None, None])
        return bank._with_noise(other.log_weight, other.shape, other.scale)

    def with_white(self, white: FloatArray) -> "Bank":
        """Restart σ², the variance of the mean of a second, (rad/s)², (3,)."""
        scale = np.zeros_like(self.scale) + PRIOR_SHAPE * white[:, None]
        return self.with_learned_noise(replace(self, shape=PRIOR_SHAPE, scale=scale))


def _modes(
    b: FloatArray | None, k: FloatArray | None, slopes: Sequence[float], white: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return `noise_scale` over E[σ²], `white`, of each mode, (3, F, 8), and ln of the prior, (3, F)."""
    if b is None or k is None:
        corners = np.array(FLICKER_CORNERS_S)
        b = np.tile(np.append(1.0 / (FLOOR_OF_FLICKER * np.sqrt(corners)), 0.0), (3, 1))
        k = np.tile(np.append(0.0 * corners, math.sqrt(3.0) / WALK_CORNER_S), (3, 1))
        prior = np.append(np.where(corners == 1.0, STRONG_FLICKER, 1.0), 1.0)
    else:
        b, k = ((one / np.sqrt(white))[:, None] for one in (b, k))
        prior = np.ones(1)
    noise_scale = np.zeros((*b.shape, len(slopes), STATES))
    noise_scale[..., WALK] = k[..., None] ** 2
    flicker_variance = b**2 * math.log(TAUS_S[2] / TAUS_S[1]) / math.pi
    noise_scale[..., FLICKER] = flicker_variance[..., None, None]
    noise_scale[..., SLOPE] = np.square(slopes) / SLOPE_DEGC
    return noise_scale.reshape(3, -1, STATES), np.tile(np.log(np.repeat(prior, len(slopes))), (3, 1))
