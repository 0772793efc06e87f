"""The law of the bias at each sample: a unit in the hand is in another pose a quarter of a second later.

With d the specific force of a sample less f0, and terms and covariance of `Law.terms`::

    bias     = t0 + t · d
    variance = C00 + 2 C0 · d + d · C d + added

At rest, and without accelerometers, d is that of the slot: there its noise is no change of pose.  All
sums are of arrays over the samples, so they are the same whatever the division into blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.estimation.gyro_bias.law import Law

PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
"""Of (1, d): the products that the variance is a sum of."""


class Shown(NamedTuple):
    """The law from the end of a slot on; NaN where nothing is known."""

    terms: FloatArray
    """t, (4, 3)."""
    squares: FloatArray
    """Coefficients of `PAIRS`, (10, 3)."""
    reference: FloatArray
    """f0, (3,)."""
    bias: FloatArray
    variance: FloatArray
    """At the specific force of the slot, (3,)."""
    ambiguity: FloatArray
    """Variance by the hypothesis of the bias that is not shown, (3,)."""


NOTHING = Shown(*(np.full(shape, np.nan) for shape in ((4, 3), (10, 3), (3,), (3,), (3,), (3,))))


def shown_by(law: Law, added: FloatArray, ambiguity: FloatArray, force: FloatArray) -> Shown:
    """Return what holds by a law with more variance, and an ambiguity, (3,), at the specific force of a slot,
    (3,)."""
    terms, covariance = law.terms()
    covariance[:, 0, 0] += added
    squares = np.array([covariance[:, i, j] * (1.0 if i == j else 2.0) for i, j in PAIRS])
    d = np.nan_to_num(force - law.force)
    row = np.array([1.0, *d])
    variance = np.maximum(covariance @ row @ row, 0.0)
    return Shown(terms.T, squares, law.force, terms @ row, variance, ambiguity)


def at_samples(
    rows: IntArray, every: list[Shown], force: FloatArray, moving: BoolArray, reported: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return bias and variance of samples, (n, 3) each.

    Parameters
    ----------
    rows : array (m,)
        From where on each but the first holds.
    every : list of Shown, m + 1
    force : array (n, 3)
    moving : array of bool (n,)
    reported : array (n, 3)
        A turn that may be a change of the bias, by the rest detector, rad/s: its square is an ambiguity, too.
    """
    n = len(moving)
    which = np.searchsorted(rows, np.arange(n), side="right")
    bias = np.array([one.bias for one in every])[which]
    variance = np.array([one.variance for one in every])[which]
    ambiguity = np.maximum(np.array([one.ambiguity for one in every])[which], reported**2)
    here = np.flatnonzero(moving)
    if not len(here):
        return bias, variance + ambiguity
    k = which[here]
    d = force[here] - np.array([one.reference for one in every])[k]
    known = np.isfinite(d).all(1)
    here, k, d = here[known], k[known], d[known]
    terms = np.array([one.terms for one in every]).transpose(1, 0, 2)
    squares = np.array([one.squares for one in every]).transpose(1, 0, 2)
    row = [np.ones((len(d), 1)), d[:, :1], d[:, 1:2], d[:, 2:]]
    bias[here] = sum(part * term[k] for part, term in zip(row, terms, strict=True))
    total = sum(row[i] * row[j] * square[k] for (i, j), square in zip(PAIRS, squares, strict=True))
    variance[here] = np.maximum(total, 0.0)
    return bias, variance + ambiguity
