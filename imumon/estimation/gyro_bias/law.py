"""The bias as a law: what it is at each sample, given its specific force, its temperature and how it turned.

From slot to slot the filters say what the bias is and how it follows the specific force and the temperature.
A unit in the hand is in another pose half a second later, so at each sample in motion::

    bias     = terms · r,   r = (1, T - T_slot, f - f_first rest)
    variance = r · covariance · r + (turned + EARTH_RATE / √3 times the angle turned since the slot)²

The last is the earth rate, as far as it is part of the bias: it keeps its direction while the unit turns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit, records
from imumon.estimation.gyro_bias.steps import SENSITIVITY, SLOPE, WALK

TERMS = 5
"""Bias, slope over temperature, and the sensitivity to the specific force along three axes."""


class Law:
    """What a slot says of the bias, of each axis (`imumon.compiled.record`).

    Parameters
    ----------
    terms, covariance : array (3, 5), (3, 5, 5)
        Mean and covariance of the terms: rad/s, rad/s/°C, and rad/s per m/s².
    degc : array (3,)
        Temperature of the slot, °C.
    reference, offset : array (3,)
        Specific force of the first rest, and by how much that of the slot differs from it, m/s².
    turned : array (3,)
        Standard deviation of what the turn since the last rest has made of the earth rate, rad/s.
    earth : float
        Earth rate that is part of the bias and turns with it, rad/s.
    """

    terms: FloatArray
    covariance: FloatArray
    degc: FloatArray
    reference: FloatArray
    offset: FloatArray
    turned: FloatArray
    earth: float


def laws(count: int) -> Sequence[Law]:
    """Return an array of laws that say nothing."""
    three = dict.fromkeys(("degc", "reference", "offset", "turned"), 3)
    made = records(Law, count, terms=(3, TERMS), covariance=(3, TERMS, TERMS), **three)
    for law in made:
        law.terms[:] = law.covariance[:] = np.nan
    return made


def at_slot(law: Law) -> tuple[FloatArray, FloatArray]:
    """Return the bias at the specific force of the slot, and its standard deviation, rad/s, (3,) each."""
    row = np.concatenate([[1.0, 0.0], law.offset])
    variance = law.covariance @ row @ row + law.turned**2
    return law.terms @ row, np.sqrt(variance)


def in_order(said: Sequence[tuple[int, Law]], before: Law) -> tuple[IntArray, Sequence[Law]]:
    """Return the rows from which on laws hold, (m,), and the laws, (m + 1,), first that of before."""
    found = laws(len(said) + 1)
    array: Any = found
    array[0] = before
    ordered = sorted(said, key=lambda one: one[0])
    for k, (_, law) in enumerate(ordered):
        array[k + 1] = law
    return np.array([row for row, _ in ordered], np.int64), found


@njit
def mixture(
    mean: FloatArray, covariance: FloatArray, weight: FloatArray, unseen2: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of the terms over the filters of a bank, (variants, 3, 5) and one more.

    `unseen2` is the variance of the sensitivities while the filters have none, the pose being the first.
    """
    variants, axes, filters = weight.shape
    first, second = np.zeros((variants, axes, TERMS)), np.zeros((variants, axes, TERMS, TERMS))
    terms = np.array([WALK, SLOPE, SENSITIVITY, SENSITIVITY + 1, SENSITIVITY + 2])
    seen = TERMS if mean.shape[-1] > SENSITIVITY else 2
    value, root = np.zeros((filters, TERMS)), np.zeros((TERMS, TERMS))
    for v in range(variants):
        for a in range(axes):
            for h in range(filters):
                x = mean[v, a, h]
                for k in range(seen):
                    value[h, k] = x[terms[k]]
                for i in range(WALK + 1, SLOPE):
                    value[h, 0] += x[i]
                for k in range(seen):
                    first[v, a, k] += weight[v, a, h] * value[h, k]
            for h in range(filters):
                p = covariance[v, a, h]
                _gather(p, terms, seen, root)
                for k in range(seen):
                    for m in range(seen):
                        spread = (value[h, k] - first[v, a, k]) * (value[h, m] - first[v, a, m])
                        second[v, a, k, m] += weight[v, a, h] * (root[k, m] + spread)
            for k in range(seen, TERMS):
                second[v, a, k, k] = unseen2
    return first, second


@njit
def _gather(p: FloatArray, terms: IntArray, seen: int, found: FloatArray) -> None:
    """Fill in the covariance of the terms of one filter; the first sums the walk and the processes."""
    for k in range(1, seen):
        for m in range(1, seen):
            found[k, m] = p[terms[k], terms[m]]
        found[0, k] = 0.0
        for i in range(WALK, SLOPE):
            found[0, k] += p[i, terms[k]]
        found[k, 0] = found[0, k]
    found[0, 0] = 0.0
    for i in range(WALK, SLOPE):
        for j in range(WALK, SLOPE):
            found[0, 0] += p[i, j]


class Path:
    """Angle turned since the last slot, rad, and when it was added to, ns (`imumon.compiled.record`)."""

    angle: float
    time_ns: int


@njit
def at_samples(
    rows: IntArray,
    laws: Any,
    path: Any,
    time_ns: IntArray,
    moving: npt.NDArray[np.bool_],
    gyro: FloatArray,
    force: FloatArray,
    degc: FloatArray,
    bias: FloatArray,
    sd: FloatArray,
) -> None:
    """Fill in bias and standard deviation of samples, (n, 3); `laws` (m + 1) hold from `rows` (m,) on.

    At rest, and without accelerometers, the specific force is that of the slot: there its noise says nothing.
    """
    row, k = np.zeros(TERMS), 0
    for i in range(len(time_ns)):
        while k < len(rows) and rows[k] <= i:
            k += 1
            path.angle = 0.0
        law = laws[k]
        here = moving[i] and np.isfinite(force[i, 0] + force[i, 1] + force[i, 2])
        _turn(path, time_ns[i], moving[i], gyro[i], law.terms)
        row[0] = 1.0
        for j in range(3):
            row[2 + j] = force[i, j] - law.reference[j] if here else law.offset[j]
        for a in range(3):
            warming = degc[i, a] - law.degc[a]
            row[1] = warming if np.isfinite(warming) else 0.0
            value = variance = 0.0
            for m in range(TERMS):
                value += row[m] * law.terms[a, m]
                for n in range(TERMS):
                    variance += row[m] * law.covariance[a, m, n] * row[n]
            earth = law.turned[a] + law.earth / math.sqrt(3.0) * min(path.angle, 2.0)
            bias[i, a], sd[i, a] = value, math.sqrt(variance + earth * earth)


@njit
def _turn(path: Any, now_ns: int, moving: bool, gyro: FloatArray, mean: FloatArray) -> None:
    """Add the turn up to a sample."""
    x, y, z = gyro[0] - mean[0, 0], gyro[1] - mean[1, 0], gyro[2] - mean[2, 0]
    rate, dt = math.sqrt(x * x + y * y + z * z), (now_ns - path.time_ns) * 1e-9
    if moving and np.isfinite(rate) and 0.0 < dt < 1.0:
        path.angle += rate * dt
    path.time_ns = now_ns
