"""The bias as a law: what it is at each sample, given its specific force, its temperature and how it turned.

From slot to slot the filters say what the bias is and how it follows the specific force and the temperature.
A unit in the hand is in another pose half a second later, so at each sample in motion::

    bias     = terms · r,   r = (1, T - T_slot, f - f_first rest)
    variance = r · covariance · r + (turned + earth / √3 times the angle turned since the slot)² + undecided²

The earth rate, as far as it is part of the bias, keeps its direction while the unit turns.  Undecided is a
turn that may be a change of the bias: nobody knows yet, and the whole of it may be missing.  Of one that
began in a rest, the bias can have taken in no more than it has moved by since that rest began.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.compiled import inner, njit

TERMS = 5
"""Bias, slope over temperature, and the sensitivity to the specific force along three axes."""


LAW = np.dtype(
    [
        ("terms", np.float64, (3, TERMS)),
        ("covariance", np.float64, (3, TERMS, TERMS)),
        ("degc", np.float64, 3),
        ("reference", np.float64, 3),
        ("offset", np.float64, 3),
        ("turned", np.float64, 3),
        ("undecided", np.float64, 3),
        ("moved", np.float64, 3),
        ("earth", np.float64),
    ]
)
"""What a slot says of the bias, of each axis: mean and covariance of the terms, in rad/s, °C and m/s²; the
temperature of the slot; the specific force of the first rest, and by how much that of the slot differs from
it; the standard deviation of what the turn since the last rest has made of the earth rate that is part of the
bias; a turn at the end of the slot that may be a change of the bias, and how much of it the bias can have
taken in; and the earth rate, rad/s."""
PATH = np.dtype([("angle", np.float64), ("time_ns", np.int64)])
"""Angle turned since the last slot, rad, and when it was added to."""
Laws = npt.NDArray[np.void]


def no_law() -> Laws:
    """Return a law that says nothing, (1,)."""
    law: Laws = np.zeros(1, LAW)
    law["terms"] = law["covariance"] = np.nan
    law["moved"] = np.inf
    return law


def at_slot(law: Laws) -> FloatArray:
    """Return the bias at the specific force of the slot, rad/s, (3,)."""
    terms = law["terms"][0]
    return np.asarray(terms[:, 0] + terms[:, 2:] @ law["offset"][0])


def sd_at_slot(law: Laws) -> FloatArray:
    """Return its standard deviation, rad/s, (3,)."""
    row = np.concatenate([[1.0, 0.0], law["offset"][0]])
    return np.asarray(np.sqrt(law["covariance"][0] @ row @ row + law["turned"][0] ** 2))


@njit
def surprise(law: Any, rate: FloatArray, noise2: FloatArray) -> float:
    """Return the largest squared difference of rate and bias at the slot, (3,), over its variance."""
    most = 0.0
    for a in range(3):
        off, variance = rate[a] - law[0].terms[a, 0], noise2[a] + law[0].covariance[a, 0, 0]
        for m in range(3):
            off -= law[0].offset[m] * law[0].terms[a, 2 + m]
            variance += 2.0 * law[0].offset[m] * law[0].covariance[a, 0, 2 + m]
            for n in range(3):
                variance += law[0].offset[m] * law[0].covariance[a, 2 + m, 2 + n] * law[0].offset[n]
        most = max(most, off * off / variance)
    return most


@njit
def at_samples(
    rows: IntArray,
    laws: Any,
    since: Any,
    time_ns: IntArray,
    moving: BoolArray,
    gyro: FloatArray,
    force: FloatArray,
    degc: FloatArray,
    turn: FloatArray,
    bias: FloatArray,
    sd: FloatArray,
) -> None:
    """Fill in bias and standard deviation of samples, (n, 3).

    The first of the `laws` (m + 1,) holds at first, the others from `rows` (m,) on; `since` (1,) is a `PATH`.
    At rest, and without accelerometers, the specific force is that of the slot: there its noise says nothing.
    """
    row, k, path = np.empty(TERMS), 0, since[0]
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
            undecided = min(max(abs(turn[i, a]), abs(law.undecided[a])), law.moved[a])
            bias[i, a], sd[i, a] = value, math.sqrt(variance + earth * earth + undecided * undecided)


@inner
def _turn(path: Any, now_ns: int, moving: bool, gyro: FloatArray, mean: FloatArray) -> None:
    """Add the turn up to a sample."""
    x, y, z = gyro[0] - mean[0, 0], gyro[1] - mean[1, 0], gyro[2] - mean[2, 0]
    rate, dt = math.sqrt(x * x + y * y + z * z), (now_ns - path.time_ns) * 1e-9
    if moving and np.isfinite(rate) and 0.0 < dt < 1.0:
        path.angle += rate * dt
    path.time_ns = now_ns
