"""How loud each part of a record is: noise belongs to a time, and what shook for seconds says little there.

A lorry, a slammed door, or a hand that sets the unit down has a scatter of its own.  Beside the quiet of
the rest it counts by the inverse of its variance.  Sway that has been there all the time is not loud: it
keeps all of its weight, since weights that vary would let the rate of a bounded angle into a mean.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import BoolArray, FloatArray

TOGETHER = 16
"""Rows, 4 s of slots, of which a scatter is taken: some periods of what a floor does after a shock."""
LEAST_ROWS = 4 * TOGETHER
"""In fewer rows nothing tells what is usual."""
QUIET = 0.25
"""The usual is the scatter below which this share of the rows is: the rest may all be loud."""
LOUD = 8.0
"""Times the usual variance: white noise has less in any four seconds of a record of 4000 rows."""


def quietness(rate: FloatArray, valid: BoolArray) -> FloatArray:
    """Return by how much each row counts, (n,), from rates, (n, 3); zero where it is not valid, (n,).

    One where it is not loud.  Horizontal gyros see tilts that are slow and belong to the record: their
    neighbours are compared.  The vertical one sees none: what it leaves its usual rate by, the unit turns.
    """
    weight = valid.astype(np.float64)
    if valid.sum() < LEAST_ROWS:
        return weight
    kept = rate[valid]
    steps = np.diff(kept[:, :2], axis=0, prepend=kept[:1, :2])
    squares = np.column_stack([0.5 * steps**2, (kept[:, 2] - np.median(kept[:, 2])) ** 2])
    total = np.cumsum(np.concatenate([np.zeros((1, 3)), squares]), axis=0)
    first = np.clip(np.arange(len(kept)) - TOGETHER // 2, 0, len(kept) - TOGETHER)
    scatter = total[first + TOGETHER] - total[first]
    usual = np.quantile(scatter, QUIET, axis=0) + np.finfo(np.float64).tiny
    weight[valid] = np.minimum(1.0, LOUD / np.maximum(scatter / usual, LOUD).max(axis=1))
    return weight
