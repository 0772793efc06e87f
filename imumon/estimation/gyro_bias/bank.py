"""Rotation about one gyro axis at rest, its bias, and how much that bias wanders: a bank of Kalman filters.

States of a filter, for one axis of the body:

    rotation since the unit came to rest, rad: integrated rate less bias
    velocity over g, rad s: the integral of the rotation less that of the tilt by the accelerometers
    bias: what walks at random (K), and what comes and goes within 10, 100 and 1000 s, rad/s
    slope over temperature, rad/s/°C; only in the variant that learns it
    sensitivity to the specific force, rad/s per m/s², 3: a row of the matrix of `effects.g_sensitivity`

Zero velocity is a measurement of the second.  How strong the wander is, relative to the white noise, is not
known beforehand: filters side by side hold one answer each, and an interacting multiple model (Blom and
Bar-Shalom 1988) weighs them by their innovations.  All arrays have the leading axes (variant, axis, filter):
variants are without and with slope, filters are wanders for each sensitivity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import steps
from imumon.estimation.gyro_bias.intake import SLOT_S
from imumon.estimation.gyro_bias.law import TERMS
from imumon.estimation.gyro_bias.steps import LEAST_WEIGHT, ROTATION, SLOPE, STATES, TAUS_S, WALK
from imumon.filters.noise import FLOOR_PER_INSTABILITY, INSTABILITY_PER_DECADE, flicker_sd

SENSITIVITY = slice(steps.SENSITIVITY, STATES)
FLICKER_BELOW = 0.015
"""Random walk (per sqrt(s)) that goes on as flicker does below 1/1000 s, over the sd of a decade."""
FLICKER_CORNERS_S = (400.0, 40.0, 4.0, 0.4, 0.04)
"""Averaging times at which flicker noise overtakes the white noise, one filter each: data sheets of MEMS
gyros have 0.3 °/h at 0.15 °/√h to 40 °/h at 0.3 °/√h.  A filter of half a step too much or too little, a
factor of 1.8 in strength, errs by 8 % more."""
WALK_CORNERS_S = (60.0, 12.0, 2.5, 0.2)
"""The same for random walks: biases that follow an unknown temperature.  The last is of a quiet gyro that its
temperature drives, 0.65 °/h each second (40 °/h/°C, 1 °C a minute) beside 0.001 °/√h."""
PRIORS = (0.2, 0.2, 0.2, 0.199, 0.001, 0.08, 0.07, 0.049, 0.001)
"""Weights before any measurement.  A gyro that is nearly all flicker, or walk, is rare; were it likelier than
this that one begins to be (each `DWELL_S`), a bias that jumps would look like one before it contradicts all
filters."""
DWELL_S = 3600.0
"""Mean time after which a bias begins to behave differently."""
UNKNOWN_BIAS = 1.0
"""Standard deviation of the bias before any measurement, rad/s."""
UNKNOWN_ROTATION = 0.01
"""The same of the rotation when the unit has come to rest, rad: how far the first reading may be off."""
SLOPE_PER_NOISE = 3.6
"""Standard deviation of a slope before any measurement, per °C and sqrt(s), over the angular random walk:
what is noisy drifts with temperature as well.  60 °/h/°C at 0.28 °/√h."""


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """What the filters of a bank assume of the bias."""

    strength2: FloatArray
    """K² of the walk and sd² of each process, of each axis, (3, filters, 4)."""
    prior: FloatArray
    """Weights before any measurement, (filters,)."""
    white2: FloatArray
    """Variance of what is white, over that of the second differences of slots, (filters,): what moves fast is
    in these as well."""
    relative: bool
    """Whether the noise is in units of the axis' angular random walk, or in rad/s."""
    sensitivity_sd: FloatArray
    """Standard deviations of the sensitivities to the specific force that are tried, rad/s per m/s²,
    (groups,)."""

    @property
    def in_one_pose(self) -> Family:
        """The same without sensitivities."""
        return replace(self, sensitivity_sd=NO_SENSITIVITY)

    @property
    def filters(self) -> int:
        """Filters of an axis."""
        return len(self.prior) * len(self.sensitivity_sd)

    @property
    def prior_of_all(self) -> FloatArray:
        """Weights of all filters of an axis before any measurement, (filters,)."""
        return np.tile(self.prior, len(self.sensitivity_sd)) / len(self.sensitivity_sd)

    def unit2(self, white: FloatArray) -> FloatArray:
        """Return what `strength2` is in units of, (3,); `white` (3,) is the angular random walk."""
        return np.asarray(white**2) if self.relative else np.ones(3)


NO_SENSITIVITY = np.zeros(1)


def in_differences() -> FloatArray:
    """Return what the walk and the processes make of second differences of slots, over white noise, (4,).

    Each of unit strength; the white noise of unit density has 6 over the length of a slot.
    """
    h = SLOT_S / TAUS_S
    alone, beside = 2.0 * (h + np.expm1(-h)) / h**2, np.expm1(-h) ** 2 / h**2
    markov = (6.0 * alone - 8.0 * beside + 2.0 * beside * np.exp(-h)) * SLOT_S / 6.0
    return np.append(SLOT_S**2 / 6.0, markov)


def unknown_family(sensitivity_sd: FloatArray = NO_SENSITIVITY, white_known: bool = False) -> Family:
    """Return the filters for a gyro of which nothing is known, or its white noise alone."""
    instability = 1.0 / (FLOOR_PER_INSTABILITY * np.sqrt(FLICKER_CORNERS_S))
    walks = math.sqrt(3.0) / np.array(WALK_CORNERS_S)
    markov = flicker_sd(np.concatenate([instability, np.full(len(walks), instability[0])]), TAUS_S)
    walk = np.concatenate([FLICKER_BELOW * instability / INSTABILITY_PER_DECADE, walks])
    strength2 = np.column_stack([walk, markov]) ** 2
    white2 = np.ones(len(walk)) if white_known else 1.0 / (1.0 + strength2 @ in_differences())
    strength2 *= white2[:, np.newaxis]
    return Family(np.tile(strength2, (3, 1, 1)), np.array(PRIORS), white2, True, sensitivity_sd)


def known_family(
    bias_instability: FloatArray, rate_random_walk: FloatArray, sensitivity_sd: FloatArray = NO_SENSITIVITY
) -> Family:
    """Return the one filter for a gyro whose B and K are known, (3,) each, rad/s and rad/s/sqrt(s)."""
    strength = np.column_stack([rate_random_walk, flicker_sd(bias_instability, TAUS_S)])
    return Family(strength[:, np.newaxis] ** 2, np.ones(1), np.ones(1), False, sensitivity_sd)


@dataclass(slots=True, eq=False)
class Bank:
    """The filters of three axes, without and (when it is learned) with slope."""

    family: Family
    mean: FloatArray
    covariance: FloatArray
    """Of the states, (variants, 3, filters, 10)."""
    weight: FloatArray
    """Probabilities, (variants, 3, filters)."""
    noted: FloatArray
    settled: FloatArray
    """The same at the last mixing, and at the one before: what they were before something happened."""

    @property
    def in_a_row(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Means, covariances and weights of all filters, (n, states), (n, states, states) and (n,)."""
        n, states = self.weight.size, self.mean.shape[-1]
        return (
            self.mean.reshape(n, states),
            self.covariance.reshape(n, states, states),
            self.weight.reshape(n),
        )


def start(family: Family, variants: int, white: FloatArray) -> Bank:
    """Return a bank that knows nothing; `white` (3,) is the angular random walk, rad/sqrt(s)."""
    shape = (variants, 3, family.filters)
    states = STATES if family.sensitivity_sd.any() else SENSITIVITY.start
    p = np.zeros((*shape, states, states))
    processes = np.arange(WALK + 1, SLOPE)
    p[..., WALK, WALK] = UNKNOWN_BIAS**2
    strength2 = family.strength2[..., 1:] * family.unit2(white)[:, np.newaxis, np.newaxis]
    p[..., processes, processes] = np.tile(strength2, (1, len(family.sensitivity_sd), 1))
    p[1:, ..., SLOPE, SLOPE] = (SLOPE_PER_NOISE * white[:, np.newaxis]) ** 2
    for i in range(SENSITIVITY.start, states):
        p[..., i, i] = np.repeat(family.sensitivity_sd, len(family.prior)) ** 2
    weight = np.tile(family.prior_of_all, (variants, 3, 1))
    return Bank(family, np.zeros((*shape, states)), p, weight, weight.copy(), weight.copy())


def widen(bank: Bank, family: Family) -> None:
    """Let a bank that knew of no sensitivity to the specific force try those of a family.

    Until the pose changes all groups are the same: so it costs nothing to have one of them up to then.
    """
    times, wanders, known = len(family.sensitivity_sd), len(family.prior), SENSITIVITY.start
    shape = (*bank.mean.shape[:2], times * wanders, STATES)
    x, p = np.zeros(shape), np.zeros((*shape, STATES))
    x[..., :known] = np.concatenate([bank.mean] * times, 2)
    p[..., :known, :known] = np.concatenate([bank.covariance] * times, 2)
    for i in range(known, STATES):
        p[..., i, i] = np.repeat(family.sensitivity_sd, wanders) ** 2
    bank.family, bank.mean, bank.covariance = family, x, p
    bank.weight = np.concatenate([bank.weight] * times, 2) / times
    bank.noted = np.concatenate([bank.noted] * times, 2) / times
    bank.settled = np.concatenate([bank.settled] * times, 2) / times


def come_to_rest(bank: Bank, flat: FloatArray, arrival: FloatArray | float = 0.0) -> None:
    """Forget rotation and velocity; the bias stays.

    Parameters
    ----------
    flat : array (3,)
        Share of each axis in which gravity shows the rotation; the rest is heading, which has not changed at
        the start of a rest.
    arrival : array (3,)
        What another attitude adds to the variance of the bias, (rad/s)².
    """
    x, p = bank.mean, bank.covariance
    x[..., :WALK] = 0.0
    p[..., :WALK, :] = 0.0
    p[..., :, :WALK] = 0.0
    p[..., ROTATION, ROTATION] = flat[:, np.newaxis] * UNKNOWN_ROTATION**2
    p[..., WALK, WALK] += np.broadcast_to(arrival, 3)[:, np.newaxis]


def wander(
    bank: Bank,
    white: FloatArray,
    dt: float,
    warming: FloatArray,
    difference: FloatArray,
    growth: FloatArray,
) -> None:
    """Bring the biases `dt` seconds on.

    Parameters
    ----------
    white : array (3,)
        Angular random walk, rad/sqrt(s).
    warming : array (3,)
        Change of the temperature, °C, for the variant that learns its slope.
    difference : array (3,)
        The same without the noise, as a distance: the slope is another at another temperature.
    growth : array (3,)
        What an unknown or uncertain temperature adds to the variance of the bias, (rad/s)².
    """
    mean, covariance, _ = bank.in_a_row
    family = bank.family
    unit2 = family.unit2(white)
    steps.wander(mean, covariance, family.filters, family.strength2, unit2, dt, warming, difference, growth)


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """A slot at rest, as the bank sees it."""

    dt: float
    """Its length, s."""
    rate: FloatArray
    tilt: FloatArray
    """Mean of the gyro, rad/s, and of the tilt by the accelerometers, rad, (3,)."""
    force: FloatArray
    """Specific force less that of the first rest, m/s², (3,)."""
    white2: FloatArray
    tilt2: FloatArray
    """Densities of the noises of rate, as second differences show it, and tilt, rad²/s and rad² s, (3,)."""
    still2: FloatArray
    """Variance of the velocity over g at rest, (rad s)², (3,)."""


def bias_row(bank: Bank, force: FloatArray) -> FloatArray:
    """Return what makes the bias of the states, (states,)."""
    row = np.zeros(bank.mean.shape[-1])
    row[WALK:SLOPE] = 1.0
    row[SENSITIVITY] = force[: len(row) - SENSITIVITY.start]
    return row


def integrate(bank: Bank, slot: AtRest) -> None:
    """Integrate the rotation over a slot; `take` accepts what the zero velocity at its end says."""
    mean, covariance, _ = bank.in_a_row
    steps.integrate(
        mean,
        covariance,
        bias_row(bank, slot.force),
        bank.family.filters,
        slot.dt,
        slot.rate,
        slot.tilt,
        slot.white2,
        bank.family.white2,
        slot.tilt2,
    )


def look(bank: Bank, slot: AtRest) -> tuple[FloatArray, FloatArray]:
    """Return what the zero velocity says, (variants, 3) each.

    Returns
    -------
    innovation : array
        Of the whole over its standard deviation; its sign is that of the bias.
    surprise : array
        What the squared normalised innovations of the filters are, by their weights: -2 ln of the mean of
        exp(-d²/2).
    """
    mean, covariance, _ = bank.in_a_row
    rows = bank.weight.shape[:2]
    whole, surprise = np.empty(rows), np.empty(rows)
    weight, settled = (array.reshape(-1, array.shape[-1]) for array in (bank.weight, bank.settled))
    steps.look(mean, covariance, weight, settled, slot.still2, whole.reshape(-1), surprise.reshape(-1))
    return whole, surprise


def disagreement(bank: Bank, slot: AtRest) -> FloatArray:
    """Return what the squared differences of rate and bias over their variances are, as `look` has it."""
    row = bias_row(bank, slot.force)
    white2 = np.tile(bank.family.white2, len(bank.family.sensitivity_sd))
    variance = bank.covariance @ row @ row + np.outer(slot.white2 / slot.dt, white2)
    square = (slot.rate[:, np.newaxis] - bank.mean @ row) ** 2 / variance
    least = square.min(-1)
    share = bank.settled * np.exp(0.5 * (least[..., np.newaxis] - square))
    return np.asarray(least - 2.0 * np.log(np.maximum(share.sum(-1), LEAST_WEIGHT)))


def take(bank: Bank, slot: AtRest) -> FloatArray:
    """Accept the measurement and weigh the filters; return the log-likelihoods, (variants, 3).

    How sensitive to the specific force a unit is holds for its three axes together: a group has one
    probability, to which the evidence of all axes is multiplied.
    """
    mean, covariance, weight = bank.in_a_row
    groups, wanders = len(bank.family.sensitivity_sd), len(bank.family.prior)
    likelihood, total = np.empty(len(weight)), np.empty(bank.weight.shape[:2])
    steps.correct(mean, covariance, groups * wanders, slot.still2, likelihood)
    shape = (total.size, groups, wanders)
    room = np.empty(shape[:2]), np.empty(groups)
    steps.weigh(likelihood.reshape(shape), weight.reshape(shape), *room, total.reshape(-1))
    return total


def mix(bank: Bank, dt: float) -> None:
    """Let each filter take over, after `dt` seconds, its share of what the others know (mixing of the IMM).

    A filter stays with probability exp(-dt / DWELL_S), and goes over to any of its group by its prior
    otherwise: so all of them receive the same mean of the whole.  A sensitivity to the specific force does
    not change, so that groups do not mix.
    """
    family = bank.family
    if len(family.prior) > 1:
        stay = math.exp(-dt / DWELL_S)
        room = np.empty(bank.mean.shape[-1]), np.empty(bank.covariance.shape[-2:])
        bank.settled, bank.noted = bank.noted, bank.weight.copy()
        steps.mix(*bank.in_a_row, (1.0 - stay) * family.prior, stay, *room)


def law(bank: Bank, family: Family, white: FloatArray, ahead_s: float) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of the bias and of what it follows, (variants, 3, 5) and one axis more.

    The terms are those of `law.Law`.  Before the pose has changed, `family` says what the sensitivities are.
    Both are of `ahead_s` seconds later: meanwhile the bias wanders unseen, and flickers faster than slots
    show.
    """
    mean, covariance, _ = bank.in_a_row
    rows = bank.weight.shape[:2]
    unseen2 = float(family.sensitivity_sd @ family.sensitivity_sd) / len(family.sensitivity_sd)
    value, known = np.empty((*rows, TERMS)), np.zeros((*rows, TERMS, TERMS))
    weight = bank.weight.reshape(-1, bank.weight.shape[-1])
    wanders = bank.family.strength2, bank.family.unit2(white)
    of_rows = value.reshape(len(weight), TERMS), known.reshape(len(weight), TERMS, TERMS)
    steps.law(mean, covariance, weight, *wanders, ahead_s, unseen2, *of_rows)
    return value, known
